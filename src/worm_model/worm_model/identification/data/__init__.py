# SPDX-License-Identifier: Apache-2.0
"""Runs as data of the identification: import of lab logs, extraction from recordings, check of the pitch."""
