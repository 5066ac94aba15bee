# SPDX-License-Identifier: Apache-2.0
"""Identification of all parameters from bags, by the stages of the paper's Section V.

Each stage is a module and can be called alone; `worm_model.identification.stages` runs them in order.
"""
