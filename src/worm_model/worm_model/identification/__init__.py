# SPDX-License-Identifier: Apache-2.0
"""Identification of all parameters from recordings and bench tests, by the stages of the paper's Section V.

Each stage is a module and can be called alone. `worm_model.identification.stages` calls all of them:

1. `reference_values`: given masses, pitch and unstressed length
2. `bellows`: bellows stiffness
3. `fin`: clearance and stiffnesses of the fins
4. `locomotion_stage`: friction, switching threshold and pitch, from the motion
5. `actuation_stage`: slack, gain and time constant
6. `idle`: idle power
7. `energy_stage`: bellows damping and power factor
"""
