# SPDX-License-Identifier: Apache-2.0
"""Operations on bags: cut, join, clean, export as tables, play."""
