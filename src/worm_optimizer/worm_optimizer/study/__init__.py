# SPDX-License-Identifier: Apache-2.0
"""Studies that outgrow one robot: many parameter sets, or many bags, on the cores of one machine or of a cluster.

`plan` reads what is asked, `point` computes one parameter set (the one module that knows search and robustness),
`engine` spreads blocks of points over workers, `store` keeps what is finished, `study_page` and `study_plots` show it;
`fleet` does the same for bags. The packages of requirements-study.txt are needed here and nowhere else.
"""
