# SPDX-License-Identifier: Apache-2.0
"""The pitch computed from strides, on virtual robots in a known pipe."""

from dataclasses import replace

import numpy as np
import pytest
from virtual_campaign import CAMPAIGN, VirtualCampaign, virtual_campaign

from worm_model.errors import IdentificationError
from worm_model.identification.data.strides import check_pitch, pitch_of_strides
from worm_model.identification.drift_estimates import estimate_bag
from worm_model.identification.stages import identify

DEVIATION = 2.5e-5  # m, of a ruler


@pytest.fixture(scope="module")
def campaign() -> VirtualCampaign:
    """Return two gaits that gain one and two grooves per cycle."""
    return virtual_campaign(7, (CAMPAIGN[1], CAMPAIGN[4]))


@pytest.mark.parametrize("off", [-0.06, -0.01, 0.0, 0.01, 0.06])
def test_strides_determine_the_pitch_regardless_of_the_given_one(campaign, off):
    truth = campaign.truth.pitch
    for recording in campaign.inputs.recordings:
        found = pitch_of_strides(recording, truth * (1.0 + off))
        assert found == pytest.approx(truth, rel=0.005)


@pytest.mark.parametrize("off", [-0.06, -0.04, -0.02, 0.02, 0.04, 0.06])
def test_a_wrong_pitch_is_rejected_by_health_and_identify_with_the_measured_one(campaign, off):
    wrong = campaign.reference.parameters.replace(pitch=campaign.truth.pitch * (1.0 + off))
    expected = f"pitch: given as {1e3 * wrong.pitch:.2f} mm, but the rear module gains 17.[23]"
    with pytest.raises(IdentificationError, match=expected):
        estimate_bag(campaign.inputs.recordings[0], wrong)
    with pytest.raises(IdentificationError, match=expected):
        identify(campaign.inputs, replace(campaign.reference, parameters=wrong))


@pytest.mark.parametrize("off", [-4e-5, 0.0, 4e-5])
def test_an_error_within_the_rulers_is_not_rejected(campaign, off):
    check_pitch(campaign.inputs.recordings, campaign.truth.pitch + off, DEVIATION)


def test_a_run_without_strides_gives_no_pitch(campaign):
    recording, _ = campaign.inputs.recordings
    late = recording.camera_time > 1.5 * recording.gait.period
    short = replace(recording, x1=np.where(late, np.nan, recording.x1))
    assert np.isnan(pitch_of_strides(short, campaign.truth.pitch))
    check_pitch([short], 1.1 * campaign.truth.pitch)
