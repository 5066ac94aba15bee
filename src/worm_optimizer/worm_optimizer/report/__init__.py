# SPDX-License-Identifier: Apache-2.0
"""Reports: recorded gaits, measured and predicted, as one HTML page with figures.

- `recordings` reads bags and returns their gaits.
- `recorded_gait` computes the metrics of one gait, `expectation` predicts it with intervals, and `events` lists its
  events.
- `agreement` compares measured and expected values.
- `optimisation` prepares front and price of robustness.
- `run_figures` and `front_plots` draw the figures, and `report_page` fills the template.
"""
