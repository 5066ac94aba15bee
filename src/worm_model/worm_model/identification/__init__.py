# SPDX-License-Identifier: Apache-2.0
"""From bags to parameters: the identification of the paper's Section V, stage by stage.

Each stage is a file and can be called alone; `worm_model.identification.stages` calls them in order.
"""
