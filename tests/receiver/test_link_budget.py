"""The link budget against closed forms and numbers worked by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.integrate import dblquad

from lidar_emu.errors import InputError
from lidar_emu.receiver.link_budget import coherent_power_w, haze_w_per_m
from lidar_emu.receiver.receiver_constants import build_receiver
from lidar_emu.scenario.instrument import Detection, Instrument, Optics, Receiver, Waveform
from lidar_emu.scenario.site import Atmosphere, Surface

INSTRUMENT = Instrument()
SURFACE = Surface()


@pytest.mark.parametrize("range_m", [40.0, 1000.0, 8000.0])
def test_two_modes_at_an_angle_overlap_less(range_m: float) -> None:
    """Intensities exp(-2r²/w²) of both modes on the ground, one moved aside by R times the angle."""
    error_rad = 20e-6
    optics = Optics(alignment_error_rad=error_rad)
    tilted = coherent_power_w(Instrument(optics=optics), SURFACE, None, range_m, 1.0)
    aside_w = range_m * error_rad / (0.017 * np.hypot(1, 1550e-9 * range_m / (np.pi * 0.017**2)))

    def product(y: float, x: float, apart: float) -> float:
        return float(np.exp(-2 * (x**2 + y**2) - 2 * ((x - apart) ** 2 + y**2)))

    together, apart = (dblquad(product, -4, 4, -4, 4, args=(moved,))[0] for moved in (0.0, aside_w))
    straight = coherent_power_w(INSTRUMENT, SURFACE, None, range_m, 1.0)
    assert tilted / straight == pytest.approx(apart / together, rel=1e-7)


RAYLEIGH_M = np.pi * 0.017**2 / 1550e-9


def test_air_beside_the_ground_of_mars() -> None:
    """At 1.5 km, straight down: the air's 1e-7 * 585.8 m * 1.1985 = 7.02e-5 /sr over the beam's area at the sensor, the
    ground's 0.5 * 0.25/π = 0.0398 over 7.557 times it: 0.0133, -18.7 dB.
    """
    air = Atmosphere(extinction_per_m=0.0, backscatter_per_m_sr=1e-7)
    mars = Surface(reflectance=0.25)
    haze_w = haze_w_per_m(INSTRUMENT, air) * RAYLEIGH_M * np.arctan(1500.0 / RAYLEIGH_M)
    ratio = haze_w / coherent_power_w(INSTRUMENT, mars, None, 1500.0, 1.0)
    assert 10 * np.log10(ratio) == pytest.approx(-18.75, abs=0.02)


def test_photons_detected_at_2_km() -> None:
    """1 pW for a record of 218.453 us, 0.4 heterodyne efficiency, 1 A/W, 1 mW of oscillator into 2 kohm.

    1e-12 J/s * 2.184533e-4 s / 1.602177e-19 C = 1363.48 electrons, 545.39 with the heterodyne efficiency.
    Thermal 4kT/R = 8.28389e-24 A2/Hz over shot 2qI = 3.20435e-22 A2/Hz is 0.0258520: 531.65.
    """
    quiet = Receiver(dark_current_a=0, relative_intensity_noise_db_per_hz=None, adc=None)
    model = build_receiver(Instrument(receiver=quiet))
    assert model.snr_per_w * 1e-12 == pytest.approx(531.65, abs=0.01)


def test_responsivity_beyond_one_electron_per_photon_is_refused() -> None:
    """1.25 A/W at 1550 nm: e * lambda / (h c) = 1.25016."""
    build_receiver(Instrument(receiver=Receiver(responsivity_a_per_w=1.2501)))
    with pytest.raises(InputError, match=r"receiver\.responsivity_a_per_w.*at most 1\.2502 .*got 1\.2503"):
        build_receiver(Instrument(receiver=Receiver(responsivity_a_per_w=1.2503)))


def test_snr_follows_the_record_and_the_efficiencies() -> None:
    base = build_receiver(INSTRUMENT).snr_per_w
    half_record = Instrument(waveform=Waveform(fft_length=2**16))
    assert build_receiver(half_record).snr_per_w == pytest.approx(base / 2)
    optics = Optics(heterodyne_efficiency=0.2)
    assert build_receiver(Instrument(optics=optics)).snr_per_w == pytest.approx(base / 2)
    hann = Instrument(detection=Detection(window="hann"))
    assert build_receiver(hann).snr_per_w == base
