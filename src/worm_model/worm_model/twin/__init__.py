# SPDX-License-Identifier: Apache-2.0
"""Digital twin: a compiled core that follows a robot sample by sample, and the modules that use the core's results."""
