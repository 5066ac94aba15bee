# SPDX-License-Identifier: Apache-2.0
"""Recovery of every readable message of a damaged bag into a new one."""
