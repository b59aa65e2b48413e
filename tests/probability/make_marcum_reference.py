"""Makes marcum_reference.json: ln Q and ln(1 - Q) by the definition, with 50 digits. Run it by hand.

Q_1(a, b) is the integral of x exp(-(x² + a²)/2) I_0(ax) from b. The smaller tail is summed over panels in which the
integrand falls by a few orders of magnitude, from b outward until it has fallen by e^-110.
"""

from __future__ import annotations

import json
from pathlib import Path

from mpmath import mp, mpf

PAIRS = [
    *((0.0, b) for b in (1e-8, 1e-3, 1.0, 5.0, 37.0, 1e4)),
    *((a, a) for a in (1e-8, 1e-3, 0.3, 1.0, 4.9, 5.1, 30.0, 1e3, 1e4)),
    (1e-6, 2e-6), (1e-3, 0.9), (0.5, 0.01), (0.99, 0.98), (0.99, 1.01), (1.0, 2.0), (3.0, 3.0), (5.0, 6.0),
    (6.0, 6.0), (8.0, 6.0), (1e4, 1e-4), (1e-4, 1e4), (2.0, 12.4), (2.0, 12.6), (12.4, 2.0), (12.6, 2.0),
    (0.7, 36.0), (36.0, 0.7), (0.68, 37.0), (25.0, 1.0), (26.0, 1.0), (1.0, 26.0), (30.0, 0.1), (37.0, 0.5),
    (40.0, 3.0), (38.0, 8.0), (38.0, 11.0), (11.0, 38.0), (100.0, 80.0), (80.0, 100.0), (300.0, 264.0),
    (264.0, 300.0), (300.0, 299.0), (299.0, 300.0), (1e4, 9999.0), (9999.0, 1e4), (1e4, 9965.0), (9965.0, 1e4),
    (1e4, 2500.0), (2400.0, 1e4), (1e4, 1.0), (1.0, 1e4), (1e3, 0.02), (1e3, 0.03), (6.0, 37.0), (17.3, 23.9),
]  # fmt: skip


def tails(a: float, b: float) -> tuple[str, str]:
    """ln Q and ln P."""
    a, b = mpf(a), mpf(b)
    downward = b < max(a, 1)
    reach = 1 / (abs(a - b) + 1)
    edges = [b]
    while abs(edges[-1] - b) < min(110 * reach, mpf(16)) and (edges[-1] > 0 or not downward):
        edges.append(max(edges[-1] - 4 * reach, mpf(0)) if downward else edges[-1] + 4 * reach)
    # Without its smallest factor, since quad's error is absolute.
    integral = mp.quad(
        lambda x: _scaled_density(a, b, x), sorted(edges), method="gauss-legendre", maxdegree=6
    )
    tail = integral * mp.exp(-((b - a) ** 2) / 2)
    smaller, larger = (mp.nstr(value, 25) for value in (mp.log(tail), mp.log1p(-tail)))
    return (larger, smaller) if downward else (smaller, larger)


def _scaled_density(a: mpf, b: mpf, x: mpf) -> mpf:
    return x * mp.exp(((b - a) ** 2 - (x - a) ** 2) / 2) * mp.exp(-a * x) * mp.besseli(0, a * x)


if __name__ == "__main__":
    mp.dps = 50
    rows = [[a, b, *tails(a, b)] for a, b in PAIRS]
    text = ",\n".join(json.dumps(row) for row in rows)
    Path(__file__).with_suffix("").with_name("marcum_reference.json").write_text(f"[\n{text}\n]\n")
