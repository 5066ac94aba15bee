# SPDX-License-Identifier: Apache-2.0
"""What a gait is worth when the parameters are uncertain: scenarios and success probabilities."""
