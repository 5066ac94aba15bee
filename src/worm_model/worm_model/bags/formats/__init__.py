# SPDX-License-Identifier: Apache-2.0
"""Formats of bags: MCAP, sqlite3, metadata.yaml, message definitions and CDR, with their files and folders."""
