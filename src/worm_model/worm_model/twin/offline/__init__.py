# SPDX-License-Identifier: Apache-2.0
"""The twin over a whole recording: columns instead of samples, for what `worm_model.twin.core` would yield.

`timeline` orders the samples as the twin takes them, `beginnings` cuts them where runs begin; each such stretch is
followed at once: `drive` (which lengths drive, when they are followed and published), `motion` (rows, power,
energy), `comparison` (when each observation is judged), `cycles` (missed grooves), `records` (health). `follow` puts it
together. Of a recording in which something happens that only samples one by one can tell, `Irregular` says so.
"""
