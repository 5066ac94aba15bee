# SPDX-License-Identifier: Apache-2.0
"""The console in a real browser, with the virtual robot's whole graph behind it, which the tests share."""

import re
from collections.abc import Iterator
from pathlib import Path

import pytest
from console_rig import NEEDS_BROWSER, TIMEOUT_S, Console, press, state, status, sync_api
from harness import Processes

from worm_model.parameters import Parameters

pytestmark = [*NEEDS_BROWSER, pytest.mark.xdist_group("console with robot")]
HEAVIER = Parameters(rear_mass=0.45)


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory, module_domain: int) -> Iterator[Console]:
    folder = tmp_path_factory.mktemp("console")
    with Processes(folder) as processes:
        console = Console(processes, folder, "--virtual", "--set", f"directory={folder / 'robot'}")
        yield console
        console.process.interrupt()
        assert console.process.wait(TIMEOUT_S) == 0


@pytest.fixture
def second(console: Console, tmp_path: Path) -> Iterator[Console]:
    """Start a console on the graph of the first."""
    with Processes(tmp_path) as processes:
        yield Console(processes, tmp_path)


def choose_a_gait(page: "sync_api.Page") -> None:
    """Take control, activate the driver, and choose a gait of the front."""
    expect = sync_api.expect
    expect(page.get_by_role("button", name="Home")).to_be_disabled()
    press(page, "Take control")
    expect(page.get_by_role("button", name="Release control")).to_be_visible()
    press(page, "Activate")
    expect(state(page)).to_have_text("idle")
    expect(page.get_by_role("button", name="Run", exact=True)).to_be_disabled()
    page.get_by_role("button", name="Read front").click()
    points = page.locator('.front svg path[fill="#0072B2"]')
    expect(points.first).to_be_visible()
    points.last.click()  # the others are partly below their neighbours
    page.get_by_label("How many").fill("1000")  # a busy browser shows the run before its end
    expect(page.get_by_role("button", name="Run", exact=True)).to_be_enabled()


def test_a_page_without_connection_shows_it_and_comes_back_without_control(
    page: "sync_api.Page", console: Console
):
    expect = sync_api.expect
    console.open(page)
    expect(state(page)).to_have_text("inactive")
    press(page, "Take control")
    expect(page.get_by_role("button", name="Release control")).to_be_visible()
    page.context.set_offline(True)
    page.evaluate("window.socket.io.engine.close()")
    connection = page.locator("#connection")
    expect(connection).to_contain_text("no connection")
    expect(page.locator("main")).to_have_attribute("inert", "")
    expect(page.get_by_text("This page has control")).to_be_hidden()
    press(page, "STOP (Esc)")
    expect(connection).to_contain_text("CANNOT BE DELIVERED")
    page.context.set_offline(False)
    expect(connection).to_be_empty()
    expect(page.get_by_role("button", name="Take control")).to_be_visible()
    expect(page.get_by_text(re.compile("lost control: Take control")).first).to_be_visible()


def test_a_gait_is_run_stopped_found_and_reported(page: "sync_api.Page", console: Console):
    expect = sync_api.expect
    console.open(page)
    choose_a_gait(page)
    press(page, "Run")
    expect(status(page)).to_contain_text(re.compile(r"cycle ([2-9]|\d\d)"))
    page.get_by_role("tab", name="Live").click()
    expect(page.get_by_role("img", name=re.compile("robot seen"))).to_be_visible()
    page.keyboard.press("Escape")
    expect(state(page)).to_have_text("stopped, holding")
    expect(status(page)).to_contain_text("recorded in run_")
    expect(state(page)).to_have_text("stopped, holding")
    page.get_by_role("tab", name="Act").click()
    press(page, "Deactivate")
    expect(state(page)).to_have_text("inactive: the driver is deactivated")
    page.get_by_role("tab", name="Recordings").click()
    row = page.get_by_role("row", name=re.compile("run_"))
    row.get_by_role("checkbox").click()
    page.get_by_role("textbox", name="Search").fill("no such run")
    expect(row.get_by_role("checkbox")).to_be_checked()
    page.get_by_role("button", name="Open report").click()
    report = page.frame_locator('iframe[title="Report"]')
    expect(report.get_by_role("heading").first).to_contain_text("Worm robot")
    press(page, "Back to the list")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download").click()
    assert download.value.suggested_filename == f"{next(console.bags.glob('run_*[0-9]')).name}.zip"
    row.get_by_role("checkbox").click()
    page.get_by_role("textbox", name="Search").fill("no such run either")
    expect(row).to_have_count(0)


def test_one_page_of_two_consoles_has_control_and_its_end_ends_the_run(
    page: "sync_api.Page",
    browser: "sync_api.Browser",
    console: Console,
    second: Console,
):
    expect = sync_api.expect
    console.open(page)
    choose_a_gait(page)
    context = browser.new_context()
    context.set_default_timeout(1e3 * TIMEOUT_S)
    other = context.new_page()
    second.open(other)
    expect(other.get_by_text(re.compile("^Control: a page of "))).to_be_visible()
    press(other, "Ask for control")
    press(page, "Hand over")
    expect(other.get_by_role("button", name="Release control")).to_be_visible()
    expect(page.get_by_role("button", name="Run", exact=True)).to_be_disabled()
    press(page, "Ask for control")
    press(other, "Hand over")
    expect(page.get_by_role("button", name="Release control")).to_be_visible()
    press(page, "Run")
    expect(state(other)).to_contain_text("running")
    expect(other.get_by_role("button", name="STOP")).to_be_enabled()
    page.close()
    expect(state(other)).to_have_text("idle")
    expect(other.get_by_role("button", name="Take control")).to_be_enabled()
    context.close()
