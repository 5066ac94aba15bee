# SPDX-License-Identifier: Apache-2.0
"""Studies of many parameter sets or many bags, on the cores of one machine or of a cluster.

- `study_file` reads and validates the description of a study, and `plan` defines it.
- `point` computes the results of one parameter set: fronts, gaits, margin scans and success probabilities.
- `engine` distributes blocks of points to workers, and `store` saves finished blocks.
- `study_page` and `study_plots` present the result.
- `fleet` compares many bags with the model, as a table; `fleet_page` presents the table.
- `sensitivity` computes Sobol indices of one gait, `study_indices` those of a study.

Only this package needs the packages of requirements-study.txt.
"""
