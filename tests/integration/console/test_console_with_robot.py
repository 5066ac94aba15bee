# SPDX-License-Identifier: Apache-2.0
"""The console in a real browser, with the virtual robot's whole graph behind it, which the tests share."""

import re
from collections.abc import Iterator

import pytest
from console_rig import NEEDS_BROWSER, TIMEOUT_S, Console, press, state, status, sync_api
from harness import Processes

pytestmark = [*NEEDS_BROWSER, pytest.mark.xdist_group("console with robot")]
PHONE = {"width": 390, "height": 844}
ROBOT = re.compile("robot seen")


@pytest.fixture(scope="module")
def console(tmp_path_factory: pytest.TempPathFactory, module_domain: int) -> Iterator[Console]:
    folder = tmp_path_factory.mktemp("console")
    with Processes(folder) as processes:
        console = Console(processes, folder, "--virtual", "--set", f"directory={folder / 'robot'}")
        yield console
        console.process.interrupt()
        assert console.process.wait(TIMEOUT_S) == 0


def choose_a_gait(page: "sync_api.Page") -> None:
    """Take control, home and activate the driver, choose a gait of the front, and read its prediction."""
    expect = sync_api.expect
    expect(page.get_by_role("button", name="Home")).to_be_disabled()
    press(page, "Take control")
    expect(page.get_by_role("button", name="Release control")).to_be_visible()
    expect(state(page)).to_have_text(re.compile("^idle$|deactivated"))
    if state(page).text_content() == "idle":  # the driver activates itself once
        press(page, "Deactivate")
    expect(page.get_by_role("button", name="Home")).to_be_enabled()
    press(page, "Home")
    expect(status(page)).to_contain_text("initial length")
    press(page, "Activate")
    expect(state(page)).to_have_text("idle")
    expect(page.get_by_role("button", name="Run", exact=True)).to_be_disabled()
    front = page.get_by_role("slider", name="Gaits of the front")
    expect(front.locator(".dots")).to_be_attached()
    front.locator(".area").click()  # one click selects a gait
    expect(front).not_to_have_attribute("aria-valuenow", "0")
    page.get_by_label("How many").fill("500")  # a busy browser shows the run before its end
    expect(page.get_by_role("button", name="Run", exact=True)).to_be_enabled()


def predicted(page: "sync_api.Page") -> "sync_api.Locator":
    """Return the cells with the prediction of the gait in the fields."""
    return page.locator(".numbers .value")


@pytest.mark.parametrize("size", [None, PHONE])
def test_the_robot_is_seen_on_opening_and_after_a_reload(
    page: "sync_api.Page", console: Console, size: "sync_api.ViewportSize | None"
):
    if size is not None:
        page.set_viewport_size(size)
    console.open(page)
    robot = page.get_by_role("img", name=ROBOT)
    for _ in range(2):
        sync_api.expect(robot).to_be_in_viewport(ratio=1.0)
        sync_api.expect(page.get_by_text(re.compile("measured 29"))).to_be_attached()
        page.reload()


def test_a_page_without_connection_shows_it_and_comes_back_without_control(
    page: "sync_api.Page", console: Console
):
    expect = sync_api.expect
    console.open(page)
    expect(state(page)).to_have_text(re.compile("^idle$|deactivated"))
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
    for part in ("Run", "Home", "Cruise", "Set conditions", "STOP (Esc)"):
        button = page.get_by_role("button", name=part, exact=True)
        expect(button).to_be_in_viewport(ratio=1.0)  # all without scrolling
    for part in page.locator(".minute, .front, .scene, .fields, .numbers").all():
        expect(part).to_be_in_viewport(ratio=1.0)
    press(page, "Run")
    expect(page.get_by_text(re.compile("to spare; kept with the measured"))).to_be_visible()
    page.keyboard.press("Escape")
    expect(state(page)).to_have_text("stopped, holding")
    press(page, "Deactivate")  # waits for the end of the recording
    expect(status(page)).to_contain_text("torque is off")
    expect(state(page)).to_have_text("inactive: the driver is deactivated")
    page.get_by_role("tab", name="Recordings").click()
    row = page.get_by_role("row", name=re.compile("run_"))
    row.get_by_role("checkbox").click()
    for words, count in (("no such run", 0), ("run_", 1)):
        page.get_by_role("textbox", name="Search").fill(words)
        expect(row).to_have_count(count)
    expect(row.get_by_role("checkbox")).to_be_checked()
    page.get_by_role("button", name="Open report").click()
    report = page.frame_locator('iframe[title="Report"]')
    expect(report.get_by_role("heading").first).to_contain_text("Worm robot")
    press(page, "Back to the list")
    with page.expect_download() as download:
        page.get_by_role("button", name="Download").click()
    assert download.value.suggested_filename == f"{next(console.bags.glob('run_*[0-9]')).name}.zip"


def test_on_a_phone_a_gait_in_numbers_is_predicted_run_and_stopped_with_the_keyboard_alone(
    page: "sync_api.Page", console: Console
):
    expect = sync_api.expect
    page.set_viewport_size(PHONE)
    console.open(page)
    choose_a_gait(page)
    expect(page.get_by_role("button", name="Run", exact=True)).to_be_in_viewport(ratio=1.0)
    front = page.get_by_role("slider", name="Gaits of the front")
    front.press("End")
    speed = predicted(page).nth(2).text_content()
    expect(front).to_have_attribute("aria-valuetext", re.compile("mm/s"))
    front.press("Home")
    expect(front).to_have_attribute("aria-valuenow", "1")
    expect(predicted(page).nth(2)).not_to_have_text(str(speed))
    run = page.get_by_role("button", name="Run", exact=True)
    stroke = page.get_by_label("stroke, mm")
    stroke.fill("500")
    expect(page.get_by_text(re.compile("Run is not possible: stroke.*500.*90"))).to_be_visible()
    expect(run).to_be_disabled()
    stroke.fill("0")
    expect(page.get_by_text(re.compile("Run is not possible: stroke, mm: enter"))).to_be_visible()
    expect(predicted(page).nth(2)).to_have_text("–")  # that of the former stroke has gone
    stroke.fill("70")
    expect(page.get_by_text("probability, if the model is right")).to_be_visible()
    expect(predicted(page).nth(10)).to_have_text(re.compile(r"^[01]"))
    power = predicted(page).nth(4).text_content()
    page.get_by_text("trapezoid", exact=True).click()
    expect(predicted(page).nth(4)).to_have_text(re.compile(rf"^(?!{re.escape(str(power))})\d"))
    expect(run).to_be_enabled()
    run.press("Enter")
    expect(state(page)).to_contain_text("running")
    page.get_by_role("button", name="STOP").press("Enter")
    expect(state(page)).to_have_text("stopped, holding")
    deactivate = page.get_by_role("button", name="Deactivate")
    expect(deactivate).to_be_enabled()
    deactivate.press("Enter")
    expect(state(page)).to_have_text("inactive: the driver is deactivated")


def test_control_is_handed_over_and_the_end_of_a_page_ends_its_run(
    page: "sync_api.Page", console: Console
):
    expect = sync_api.expect
    console.open(page)
    choose_a_gait(page)
    other = page.context.new_page()
    console.open(other)
    expect(other.get_by_text("Another page has control.")).to_be_visible()
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
