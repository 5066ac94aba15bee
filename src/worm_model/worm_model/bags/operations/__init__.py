# SPDX-License-Identifier: Apache-2.0
"""Operations on bags: copies, export as tables."""
