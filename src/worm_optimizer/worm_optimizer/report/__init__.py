# SPDX-License-Identifier: Apache-2.0
"""Reports: recorded gaits, measured against predicted, as one HTML page and figures.

`recorded` reads a bag, `expectation` predicts with intervals, `events` lists what happened, `verdict` compares several
gaits, `run_figures`, `front_figures` and `parameter_figures` draw, `page` writes; `build` puts them together and
`command` is the executable.
"""
