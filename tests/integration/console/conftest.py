# SPDX-License-Identifier: Apache-2.0
"""A browser and its pages for the tests of the console."""

from collections.abc import Iterator

import pytest
from console_rig import CHROMIUM, TIMEOUT_S, sync_api

ARGUMENTS = (
    "--headless --no-sandbox --disable-gpu --disable-quic --no-first-run "
    "--disable-background-networking --disable-component-update --disable-sync"
).split()


@pytest.fixture(scope="module")
def browser() -> Iterator["sync_api.Browser"]:
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=ARGUMENTS)
        yield browser
        browser.close()


@pytest.fixture
def page(browser: "sync_api.Browser") -> Iterator["sync_api.Page"]:
    context = browser.new_context(viewport={"width": 1280, "height": 900})
    context.set_default_timeout(1e3 * TIMEOUT_S)
    page = context.new_page()
    sync_api.expect.set_options(timeout=1e3 * TIMEOUT_S)
    yield page
    context.close()
