"""Corrections of `sarcal solve --json` in plain Python, for porting to a controller. Angles in degrees."""

from math import cos, hypot, radians, sin  # noqa: F401

G = 9.80665


def corrected(q_deg, corrections, dh):
    """Return readings (n,) with every correction added; `dh` are rows {s_m, a_m, alpha_deg, theta_off_deg}."""
    z, x, p = [[0.0, 0.0, 1.0]], [[1.0, 0.0, 0.0]], [[0.0, 0.0, 0.0]]
    for q, row in zip(
        q_deg, dh, strict=True
    ):  # axes z and origins p of frames 0..n, x of links 1..n
        zj, xj = z[-1], x[-1]
        yj = cross(zj, xj)
        t, al = radians(q + row["theta_off_deg"]), radians(row["alpha_deg"])
        xn = [cos(t) * a + sin(t) * b for a, b in zip(xj, yj, strict=True)]
        yn = cross(zj, xn)
        p.append(
            [o + row["s_m"] * c + row["a_m"] * d for o, c, d in zip(p[-1], zj, xn, strict=True)]
        )
        z.append([cos(al) * c - sin(al) * b for c, b in zip(zj, yn, strict=True)])
        x.append(xn)
    out = list(q_deg)
    for c in corrections:
        j, k = c["joint"] - 1, c["coefficients"]
        q = radians(q_deg[j])
        if c["kind"] == "harmonic":
            out[j] += k[0] * sin(q) + k[1] * cos(q) + k[2] * sin(2 * q) + k[3] * cos(2 * q)
        elif c["kind"] == "linearity":
            u = max(-1.2, min(1.2, (q_deg[j] - c["middle_deg"]) / c["half_scale_deg"]))
            out[j] += sum(a * u**i for i, a in enumerate(k))
        elif c["kind"] == "gravity":
            g = [G * d for d in c["down"]]
            for link in range(j, len(dh)):
                m, hx, hy, hz = k[4 * link : 4 * link + 4]
                axes = (x[link + 1], cross(z[link], x[link + 1]), z[link])
                r = [
                    (p[link][i] - p[j][i]) * m + hx * axes[0][i] + hy * axes[1][i] + hz * axes[2][i]
                    for i in range(3)
                ]
                out[j] += sum(a * b for a, b in zip(z[j], cross(r, g), strict=True))
        else:
            out[j] += k[0]
    return out


def cross(a, b):
    return [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
