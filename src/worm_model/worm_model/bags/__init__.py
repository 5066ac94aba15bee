# SPDX-License-Identifier: Apache-2.0
"""Reading, writing and recording of bags in MCAP and other rosbag2 formats.

Only these modules depend on the file formats; all other packages use typed arrays and records.

`opening.open_bag` returns a `bag.Bag` for any supported format. `Bag.messages` reads the messages lazily.
`run_reader.read_run` returns the worm's topics as arrays (`worm_model.run.Run`), and `run_writer` writes them.

- `formats`: MCAP, sqlite3, metadata.yaml, message definitions, CDR. `bag_writer.new_bag` writes a complete bag.
- `recording`: `recorder.BagRecorder` writes a bag that stays readable if the recorder is killed.
- `operations`: export as tables, and copies: a part of a bag, or all that can be read of a damaged one.

Reading never writes. If a defect prevents reading, the functions raise a `bag_errors.BagError` with a message of one
line. They report any other defect by calling the caller's `notify` with one line.
"""
