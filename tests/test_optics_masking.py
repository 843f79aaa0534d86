# SPDX-FileCopyrightText: 2026 fipt_blender authors
# SPDX-License-Identifier: GPL-3.0-or-later
"""The two shadowing-masking functions that a run may choose."""

import mitsuba as mi
import numpy as np
import pytest

from fipt_blender.core.optics import brdf
from fipt_blender.core.run.settings import make_settings
from samples.refusals import error_of


@pytest.fixture(autouse=True)
def default_masking():
    yield
    brdf.set_masking("schlick")


def smith_lambda(cosine, alpha):
    """Walter et al. 2007: (sqrt(1 + alpha^2 tan^2) - 1) / 2."""
    return (np.sqrt(1.0 + alpha**2 * (1.0 / cosine**2 - 1.0)) - 1.0) / 2.0


def test_smith_is_height_correlated():
    cos_i, cos_o = np.array([1.0, 0.7, 0.2, 0.9]), np.array([1.0, 0.4, 0.3, 0.05])
    brdf.set_masking("smith")
    for sigma in (0.1, 0.5, 1.0):
        found = np.array(brdf.geometry_term(mi.Float(cos_i), mi.Float(cos_o), mi.Float(sigma)))
        wanted = 1.0 / (1.0 + smith_lambda(cos_i, sigma**2) + smith_lambda(cos_o, sigma**2))
        assert np.allclose(found, wanted, rtol=1e-5)


def test_default_is_the_authors():
    found = np.array(brdf.geometry_term(mi.Float(0.5), mi.Float(1.0), mi.Float(1.0)))
    assert found == pytest.approx(0.5 / 0.75)
    assert make_settings().masking == "schlick"


def test_unknown_masking():
    with pytest.raises(ValueError, match="unknown masking"):
        brdf.set_masking("none")
    assert error_of(make_settings, changes={"masking": "none"}).code == "setting-invalid"
