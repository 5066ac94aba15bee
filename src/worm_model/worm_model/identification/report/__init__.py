# SPDX-License-Identifier: Apache-2.0
"""Report of an identification: parameter file, page, figures, and the recommended next run."""
