# SPDX-License-Identifier: Apache-2.0
"""The console's pages in a real browser, without a robot."""

import os
import shutil
from collections.abc import Iterator

import pytest
from console_rig import BAGS, NEEDED, NEEDS_BROWSER, Console, press, sync_api
from harness import Processes

axe_playwright = pytest.importorskip("axe_playwright_python.sync_playwright", reason=NEEDED)
pytestmark = [*NEEDS_BROWSER, pytest.mark.xdist_group("console pages")]
LARGEST_BAR = 0.12  # share of a phone's height for state and STOP
PHONE = {"width": 390, "height": 844}


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory, module_domain: int) -> Iterator[Console]:
    """A console with two bags and no robot."""
    folder = tmp_path_factory.mktemp("console")
    with Processes(folder) as processes:
        for name in ("forward", "reverse"):
            shutil.copytree(BAGS / name, folder / "bags" / name)
        yield Console(processes, folder)


def test_two_runs_are_compared(page: "sync_api.Page", console: Console):
    expect = sync_api.expect
    console.open(page)
    page.get_by_role("tab", name="Recordings").click()
    press(page, "Compare two")
    expect(page.get_by_text("select two bags in the list")).to_be_visible()
    for name in ("forward", "reverse"):
        page.get_by_role("row", name=name).get_by_role("checkbox").click()
    press(page, "Compare two")
    report = page.frame_locator('iframe[title="Report"]')
    for name in ("forward", "reverse"):
        expect(report.get_by_role("heading").first).to_contain_text(name)


def test_no_tab_violates_the_rules_of_accessibility(page: "sync_api.Page", console: Console):
    expect = sync_api.expect
    console.open(page)
    page.add_style_tag(content="* { transition: none !important; animation: none !important }")
    axe = axe_playwright.Axe()

    def violations() -> list[str]:
        found = axe.run(page).response["violations"]
        return [f"{rule['id']}: {node['html']}" for rule in found for node in rule["nodes"]]

    for size in ({"width": 1280, "height": 900}, PHONE):
        page.set_viewport_size(size)
        for _ in ("light", "dark"):
            page.get_by_role("tab", name="Cockpit").click()
            expect(page.get_by_role("img", name="no data of the twin")).to_be_visible()
            assert violations() == []
            page.get_by_role("tab", name="Recordings").click()
            box = page.get_by_role("checkbox", name="Select forward")
            if not box.is_checked():
                box.click()
            assert violations() == []
            press(page, "Light or dark")


def test_on_a_phone_state_and_stop_stay_in_view_and_leave_room(
    page: "sync_api.Page", console: Console
):
    expect = sync_api.expect
    page.set_viewport_size(PHONE)
    console.open(page)
    expect(page.locator("#state")).to_have_text("no driver")
    bar = page.get_by_role("contentinfo").bounding_box()
    assert bar is not None
    assert bar["height"] <= LARGEST_BAR * PHONE["height"]
    for _ in range(2):
        for part in ("#state", "#stop"):
            expect(page.locator(part)).to_be_in_viewport(ratio=1.0)
        page.mouse.wheel(0, 5000)
    assert page.evaluate("document.documentElement.scrollWidth") <= PHONE["width"]


def test_other_sites_reach_neither_the_page_nor_a_file(page: "sync_api.Page", console: Console):
    console.open(page)
    rejected = page.request.get(console.address, headers={"host": "attacker.example"})
    assert rejected.status == 400
    socket = f"{console.address}_nicegui_ws/socket.io/?EIO=4&transport=polling"
    assert page.request.get(socket).ok
    assert page.request.get(socket, headers={"origin": "http://attacker.example"}).status == 400
    assert page.request.get(f"{console.address}bags/..%2f..%2fsecret").status == 404
    assert os.fspath(console.bags) not in page.request.get(f"{console.address}reports/none").text()
