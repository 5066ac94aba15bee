# SPDX-License-Identifier: Apache-2.0
"""Bags: the only modules that know MCAP and rosbag2. Everyone else sees typed arrays and records.

`opening.open_bag` gives a `bag.Bag`, whose messages are iterated lazily, whoever wrote it; `run_reader.read_run` gives
the worm's topics as arrays (`worm_model.run.Run`); `bag_writer.new_bag` writes a whole bag,
`recorder.BagRecorder` one that survives its writer; `recovery.recover` mends.
Whatever is wrong with a bag is a `bag_errors.BagError` of one line, or a line for whoever opened it: what is read is
right, or refused, or told.
"""
