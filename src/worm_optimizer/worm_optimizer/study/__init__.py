# SPDX-License-Identifier: Apache-2.0
"""Studies of many parameter sets, on the cores of one machine or of a cluster.

- `study_file` reads and validates a study.
- `point` computes the results of one parameter set: fronts, gaits, margin scans and success probabilities.
- `blocks` distributes points to Dask workers and stores finished blocks, and `study_run` writes the result.

Only this package needs the packages of the group study in pyproject.toml.
"""
