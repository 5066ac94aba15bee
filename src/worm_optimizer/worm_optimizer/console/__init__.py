# SPDX-License-Identifier: Apache-2.0
"""The robot in a browser: pages on top, below them a core that knows neither ROS nor the library of the pages."""
