# SPDX-License-Identifier: Apache-2.0
"""The digital twin: what follows a robot sample by sample (`worm_model.twin.core`), and what is made of it."""
