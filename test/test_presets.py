# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every preset loads and has a title; published ones have the published values."""

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from graphs import NONE, arrive, drive
from helpers import ahead, restored, seen

from ratslam_ros.core.config import Config
from ratslam_ros.core.mapping.experience_map import ExperienceMap
from ratslam_ros.core.pose_cells.pose_cells import PoseCells
from ratslam_ros.files.config import load_config, presets

FOLDER = Path(__file__).resolve().parents[1] / 'config'
NAMES = sorted(path.stem for path in FOLDER.glob('*.yaml'))

PUBLISHED = {
    'openratslam': {
        'template_x_size': 60, 'template_y_size': 10, 'vt_shift_match': 5, 'vt_step_match': 1,
    },
    'irat': {
        'image_crop_y_max': 150, 'template_x_size': 60, 'template_y_size': 20,
        'vt_shift_match': 4, 'vt_step_match': 1, 'vt_match_threshold': 0.03,
        'pc_dim_x': 11, 'pc_dim_y': 11, 'pc_cell_x_size': 0.015, 'pc_vt_inject_energy': 0.1,
        'exp_delta_pc_threshold': 2.0, 'exp_loops': 20, 'exp_initial_em_deg': 140.0,
    },
    'stlucia': {
        'image_crop_x_min': 40, 'image_crop_x_max': 600, 'image_crop_y_min': 150,
        'image_crop_y_max': 300, 'template_x_size': 60, 'template_y_size': 10,
        'vt_shift_match': 5, 'vt_step_match': 1, 'vt_match_threshold': 0.085,
        'vt_normalisation': 0.4, 'pc_dim_x': 30, 'pc_dim_y': 30, 'pc_cell_x_size': 2.0,
        'pc_vt_inject_energy': 0.15, 'pc_vt_restore': 0.04, 'exp_delta_pc_threshold': 1.0,
        'exp_loops': 20, 'camera_fov_deg': 53.0, 'camera_hz': 10.0, 'vtrans_scaling': 1000.0,
        'vtrans_max': 20.0, 'vtrans_image_x_min': 195, 'vtrans_image_x_max': 475,
        'vtrans_image_y_min': 270, 'vtrans_image_y_max': 430, 'vrot_image_x_min': 195,
        'vrot_image_x_max': 475, 'vrot_image_y_min': 75, 'vrot_image_y_max': 240,
    },
    'newcollege': {
        'template_x_size': 60, 'template_y_size': 10, 'vt_step_match': 1,
        'vt_match_threshold': 0.054, 'vt_patch_normalise': 2, 'vt_panoramic': True,
        'pc_dim_x': 30, 'pc_dim_y': 30, 'pc_cell_x_size': 1.0, 'pc_vt_inject_energy': 0.2,
        'exp_delta_pc_threshold': 2.0, 'exp_loops': 100,
    },
    'milford2005': {
        'pc_dim_x': 140, 'pc_dim_y': 80, 'pc_dim_th': 36, 'pc_cell_x_size': 0.25,
        'pc_vt_learning_rate': 0.15, 'goal_memory_update': 'iteration', 'camera_hz': 10.0,
        'camera_fov_deg': 50.0,
    },
    'milford2006': {
        'template_x_size': 12, 'template_y_size': 8, 'vt_shift_match': 0, 'pc_dim_x': 100,
        'pc_dim_y': 40, 'pc_dim_th': 36, 'pc_cell_x_size': 0.25, 'exp_correction': 0.5,
        'camera_hz': 7.0, 'camera_fov_deg': 50.0,
    },
    'milford2006_small': {'pc_dim_x': 40, 'pc_dim_y': 20, 'pc_dim_th': 36},
    'pioneer': {
        'template_x_size': 12, 'template_y_size': 8, 'pc_dim_th': 36, 'pc_cell_x_size': 0.25,
    },
}

# OpenRatSLAM's defaults, on which the published configurations rely.
DEFAULTS = {
    'vt_match_threshold': 0.03, 'vt_normalisation': 0.0, 'vt_patch_normalise': 0,
    'vt_min_patch_normalisation_std': 0.0, 'vt_panoramic': False, 'pc_dim_x': 21, 'pc_dim_y': 21,
    'pc_dim_th': 36, 'pc_w_e_dim': 7, 'pc_w_e_var': 1.0, 'pc_w_i_dim': 5, 'pc_w_i_var': 2.0,
    'pc_global_inhib': 0.00002, 'pc_cell_x_size': 1.0, 'vt_active_decay': 1.0,
    'pc_vt_inject_energy': 0.15, 'pc_vt_restore': 0.05, 'exp_delta_pc_threshold': 2.0,
    'exp_correction': 0.5, 'exp_loops': 10, 'exp_initial_em_deg': 90.0, 'camera_fov_deg': 50.0,
    'camera_hz': 10.0, 'vtrans_scaling': 100.0, 'vtrans_max': 20.0,
}


ORIGINALS = 'openratslam', 'irat', 'stlucia', 'newcollege'
"""Presets that behave as OpenRatSLAM."""

PAPERS = 'milford2005', 'milford2006', 'milford2006_small'
"""Presets with the mechanisms of Milford et al. (2005) and (2006)."""

ADDITIONS_OFF = {
    'inputs.max_odom_gap_s': 60.0, 'visual_odometry.vrot_height_share': 1.0,
    'visual_odometry.vrot_subpixel': False, 'visual_odometry.fov_from_camera_info': False,
    'local_view.vt_shift_fov_deg': 0.0, 'local_view.vt_shift_match_y': 0,
    'local_view.vt_min_structure': 0.0, 'local_view.vt_recent_templates': 0,
    'local_view.vt_max': 0, 'pose_cells.pc_vt_agree_views': 0.0,
    'pose_cells.pc_vt_interpolate': False, 'pose_cells.pc_vt_spare_newest': False,
    'pose_cells.odom_calibration': False, 'pose_cells.exp_view_links': False,
    'pose_cells.exp_max': 0, 'experience_map.exp_align_scans': False,
    'experience_map.exp_gate_closures': False, 'experience_map.exp_relocate': 'views',
    'experience_map.exp_confidence_threshold': 0.0, 'goal_memory.goal_memory': False,
    'goal_recall.route_back_factor': 1.0, 'goal_recall.route_join_m': 0.0,
    'goal_recall.route_switch_s': 0.0,
}
PUBLISHED_MECHANISMS = {
    'inputs.image_grey': 'mean', 'local_view.vt_descriptor': 'intensity',
    'pose_cells.pc_lattice': 'fixed', 'pose_cells.exp_current_by': 'delta',
    'experience_map.exp_relaxation': 'sweep',
}
# Mechanisms of the papers that OpenRatSLAM lacks or replaces.
OF_2005 = {
    'pose_cells.pc_vt_learning_rate': 0.15, 'goal_memory.goal_memory': True,
    'goal_memory.goal_memory_update': 'iteration', 'goal_follower.steer_by': 'goal_memory',
}
OF_2006 = {
    'pose_cells.pc_vt_learning_rate': 0.15, 'pose_cells.exp_current_by': 'activity',
    'pose_cells.exp_forget': 'visited_once',
    'experience_map.exp_relaxation': 'batch', 'experience_map.exp_unlearning': 'equation',
    'experience_map.exp_confidence_threshold': 0.1, 'goal_recall.route_back_factor': 0.0,
    'goal_recall.route_position': 'elapsed_time', 'goal_follower.path_choice': 'nearest',
}
DIFFERENT = {'milford2005': OF_2005, 'milford2006': OF_2006, 'milford2006_small': OF_2006}


def values(config: Config) -> dict[str, object]:
    """Return the values by parameter name, without sections."""
    return {name: value for section in config.values().values() for name, value in section.items()}


@pytest.mark.parametrize('name', NAMES)
def test_preset_loads_by_name_and_by_path(name: str):
    by_path, notices = load_config(str(FOLDER / f'{name}.yaml'))
    assert notices == []
    assert presets()[name] == FOLDER / f'{name}.yaml'
    assert load_config(name) == (by_path, [])


@pytest.mark.parametrize('name', NAMES)
def test_preset_begins_with_a_description(name: str):
    first = (FOLDER / f'{name}.yaml').read_text('utf-8').splitlines()[0]
    assert first.startswith('# ') and len(first) > 20


@pytest.mark.parametrize('name', sorted({*NAMES} - {'default'}))
def test_preset_names_its_base(name: str):
    base = yaml.safe_load((FOLDER / f'{name}.yaml').read_text('utf-8'))['/**']['ros__parameters']
    bases = dict.fromkeys((*ORIGINALS, *PAPERS, 'extended'), 'openratslam')
    bases |= {
        'openratslam': 'default', 'milford2006_small': 'milford2006',
        'camera_navigation': 'navigation',
    }
    assert base['base'] == bases.get(name, 'extended')


@pytest.mark.parametrize('name', PUBLISHED)
def test_published_preset_has_published_values(name: str):
    found = values(load_config(name)[0])
    assert {key: found[key] for key in PUBLISHED[name]} == PUBLISHED[name]


@pytest.mark.parametrize('name', ORIGINALS)
def test_published_preset_has_other_values_of_openratslam(name: str):
    found = values(load_config(name)[0])
    left = {key: value for key, value in DEFAULTS.items() if key not in PUBLISHED[name]}
    assert {key: found[key] for key in left} == left


# The originals behave as OpenRatSLAM


@pytest.mark.parametrize('name', [*ORIGINALS, *PAPERS])
def test_additions_are_off_in_originals(name: str):
    found = load_config(name)[0].flat()
    wanted = ADDITIONS_OFF | PUBLISHED_MECHANISMS | DIFFERENT.get(name, {})
    assert {key: found[key] for key in wanted} == wanted
    assert -1 not in [value for key, value in found.items() if '_image_' not in key
                      and 'vt_match_ratio' not in key and 'image_crop' not in key]  # automatic


@pytest.mark.parametrize('name', ORIGINALS)
def test_one_view_suffices_in_originals(name: str):
    """A recognised view injects its whole energy, whatever the views before were."""
    p = load_config(name)[0].pose_cells
    cells = PoseCells(p)
    for template_id in [*range(30), 3]:
        cells.integrate(ahead(p.pc_cell_x_size))
        cells.view(seen(template_id))
    (injection,) = cells.injections
    full = p.pc_vt_inject_energy / 30.0 * (30.0 - math.exp(1.2 * p.vt_active_decay))
    assert injection.energy == pytest.approx(full)
    assert injection.energy > 0.0


@pytest.mark.parametrize('name', ORIGINALS)
def test_sweeps_relax_map_in_originals(name: str):
    """With 0.5, a sweep moves both ends of a link until they agree with it."""
    p = load_config(name)[0].experience_map
    graph = ExperienceMap(p)
    for target in range(3):
        arrive(graph, target)
        drive(graph, ahead(1.0))
    poses = graph.poses
    assert p.exp_correction == 0.5
    disturbed = poses.copy()
    disturbed[2, 0] += 0.4
    once = restored(graph, p.__class__(exp_relaxation=p.exp_relaxation, exp_loops=1),
                    poses=disturbed)
    once.apply(NONE)
    assert once.poses[2] - once.poses[1] == pytest.approx(poses[2] - poses[1])
    assert once.poses[1, 0] - poses[1, 0] == pytest.approx(0.2)  # not the solution, which is 0
    swept = restored(graph, p, poses=disturbed)
    swept.apply(NONE)
    again = restored(graph, p, poses=disturbed)
    for _ in range(p.exp_loops):
        once = restored(graph, p.__class__(exp_relaxation='sweep', exp_loops=1),
                        poses=again.poses)
        once.apply(NONE)
        again = once
    assert np.array_equal(swept.poses, again.poses)
