"""The factorised rendering equation and its reflectances (paper Sec. 3 and Eq. 5), stated once.

    L_r = kd L_d + ks L_s0(sigma) + L_s1(sigma),    kd = a (1 - m),    ks = 0.04 (1 - m) + a m

Plain arithmetic: the functions take numpy arrays, torch tensors and Dr.Jit types alike, and this module
imports nothing, so that both processes can use it.
"""

from __future__ import annotations

from typing import Any

DIELECTRIC_REFLECTANCE = 0.04  # F0 of what is no metal (paper Sec. 3)


def diffuse_reflectance(base_color: Any, metallic: Any) -> Any:
    """kd = a (1 - m)."""
    return base_color * (1.0 - metallic)


def specular_reflectance(base_color: Any, metallic: Any) -> Any:
    """ks = 0.04 (1 - m) + a m."""
    return DIELECTRIC_REFLECTANCE * (1.0 - metallic) + base_color * metallic


def reflected_radiance(kd: Any, ks: Any, diffuse: Any, s0: Any, s1: Any) -> Any:
    """L_r from reflectances and shadings (paper Eq. 5).

    Args:
        kd, ks: reflectances.
        diffuse: L_d.
        s0, s1: L_s0 and L_s1 at the surface's roughness.
    """
    return kd * diffuse + ks * s0 + s1


def color_line(diffuse: Any, s0: Any, s1: Any, metallic: Any) -> tuple[Any, Any]:
    """(slope, offset) of L_r = slope a + offset: Eq. 5 is linear in the base colour.

    Args:
        diffuse: L_d.
        s0, s1: L_s0 and L_s1 at the surface's roughness.
        metallic: m.
    """
    slope = (1.0 - metallic) * diffuse + metallic * s0
    offset = DIELECTRIC_REFLECTANCE * (1.0 - metallic) * s0 + s1
    return slope, offset


def level_share(roughness: Any, low: Any, high: Any) -> Any:
    """Share of the upper of two baked levels, between which shadings are interpolated (after paper Eq. 8).

    The height of a lobe falls with a high power of sigma, so a sharp and a wide lobe in linear shares are too
    bright where they meet. The shares are linear in 1 / sigma^2, which is nearly right for lobes and lamps of
    all widths.

    Args:
        roughness: sigma, from `low` to `high`.
        low, high: the levels, above 0.
    """
    return (roughness**-2 - low**-2) / (high**-2 - low**-2)


def level_roughness(share: Any, low: Any, high: Any) -> Any:
    """Roughness at which the upper of two levels has this share: the inverse of :func:`level_share`."""
    return (low**-2 + share * (high**-2 - low**-2)) ** -0.5
