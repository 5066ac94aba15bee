# SPDX-License-Identifier: Apache-2.0
"""The hybrid simulator: actuation, locomotion and energy, exact between events."""
