# SPDX-License-Identifier: Apache-2.0
"""Digital twin: a core that follows a robot sample by sample (`worm_model.twin.core`), and the use of its results."""
