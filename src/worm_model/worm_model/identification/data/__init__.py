# SPDX-License-Identifier: Apache-2.0
"""Runs as data of the identification, their selection and their quality."""
