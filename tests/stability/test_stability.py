"""Every extreme, what it may report and how far off; the page of the table; light at every incidence."""

from __future__ import annotations

import numpy as np
import pytest
from make_table import ALL, PAGE, page, row
from mpmath import exp, mp, mpf, pi
from outcomes import Extreme

from lidar_emu.receiver.link_budget import coherent_power_w
from lidar_emu.scenario.instrument import Instrument
from lidar_emu.scenario.site import Atmosphere, Surface

pytestmark = pytest.mark.slow

_ERRORS = 3
_ROWS = [
    line.strip("| \n").split(" | ")
    for line in PAGE.read_text(encoding="utf-8").splitlines()
    if line[:2] == "| "
][1:]


@pytest.mark.parametrize("place", range(len(ALL)), ids=[f"{e.name}-{e.against}" for e in ALL])
def test_extreme(place: int) -> None:
    extreme: Extreme = ALL[place]
    outcome = extreme.measure()
    assert outcome.reasons <= extreme.reasons
    assert outcome.resolved or not extreme.resolved
    assert outcome.excess_m <= extreme.beside[0]
    assert outcome.excess_mps <= extreme.beside[1]
    measured, written = row(extreme, outcome), list(_ROWS[place])
    measured[_ERRORS] = written[_ERRORS] = ""
    assert measured == written


def test_the_page_holds_these_rows_and_no_more() -> None:
    assert PAGE.read_text(encoding="utf-8") == page(_ROWS)
    assert len(_ROWS) == len(ALL)


def test_power_at_every_incidence_and_range() -> None:
    """Against the link budget in 40 digits, from 1 mm to 1e6 km and to 1e-9 degrees short of grazing."""
    instrument, surface = Instrument(), Surface(reflectance=0.35, lommel_seeliger_share=0.4)
    air = Atmosphere(extinction_per_m=1e-4)
    incidence_deg = np.array([0.0, 1e-9, 45.0, 80.0, 89.0, 89.9, 89.99, 89.999999999])
    range_m = np.geomspace(1e-3, 1e9, 13)
    cos_incidence = np.cos(np.radians(incidence_deg))
    found = coherent_power_w(instrument, surface, air, range_m[:, None], cos_incidence)
    optics, wavelength = instrument.optics, instrument.waveform.wavelength_m
    for i, r in enumerate(range_m):
        for j, cosine in enumerate(cos_incidence):
            with mp.workdps(40):
                waist, lam, share = mpf(optics.waist_radius_m), mpf(wavelength), mpf(0.4)
                spread = 1 + (lam * mpf(r) / (pi * waist**2)) ** 2
                limb = share + (1 - share) * mpf(cosine)
                power = mpf(optics.laser_power_w) * optics.optical_efficiency * optics.depolarisation
                power *= (
                    mpf(0.35) / pi * limb * lam**2 / (pi * waist**2 * spread) * exp(-2 * mpf(1e-4) * mpf(r))
                )
                wanted = float(power)
            assert found[i, j] == pytest.approx(wanted, rel=1e-10, abs=5e-324)
    behind = coherent_power_w(instrument, surface, air, 1000.0, np.array([0.0, -1e-300, -1.0]))
    np.testing.assert_array_equal(behind, 0.0)
    dark = coherent_power_w(instrument, Surface(reflectance=0.0), None, range_m, 1.0)
    np.testing.assert_array_equal(dark, 0.0)
    assert np.isnan(coherent_power_w(instrument, surface, air, np.nan, 0.5))
