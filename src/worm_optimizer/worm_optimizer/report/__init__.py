# SPDX-License-Identifier: Apache-2.0
"""Reports: recorded gaits, measured against predicted, as one HTML page and figures.

`recordings` reads bags into the gaits that were played, `recorded_gait` judges one, `expectation` predicts it with
intervals, `events` lists what happened, `agreement` compares; `optimisation` and `identification_parts` get the other
sections' content, `run_figures` and `front_plots` draw, `report_page` fills the template.
"""
