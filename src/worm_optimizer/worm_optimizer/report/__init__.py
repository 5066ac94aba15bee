# SPDX-License-Identifier: Apache-2.0
"""Reports: recorded gaits, measured against predicted, as one HTML page and figures.

`choice` says which bags, `reading` reads them, `parts` cuts and joins runs, `recorded` judges a gait, `expectation`
predicts with intervals, `events` lists what happened, `verdict` compares several gaits, `optimisation` and
`identification` get the other sections' content, `run_figures`, `front_figures` and `parameter_figures` draw, `page`
writes; `build` puts them together and `command` is the executable.
"""
