# SPDX-License-Identifier: Apache-2.0
"""Recording of topics and of the run's metadata into a bag that stays readable if the recorder is killed."""
