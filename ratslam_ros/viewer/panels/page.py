# Copyright 2026 the ratslam_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the page needs besides viser: a style, and the release of removed lines."""

from __future__ import annotations

from html import escape

STYLE = """<style class="ratslam-pinned">
[data-scrollarea-viewport] div:has(.ratslam-pinned) { overflow: visible !important; }
.mantine-Paper-root:has(.ratslam-pinned):not(:has(.mantine-Paper-root .ratslam-pinned)) {
  position: sticky; top: 0; z-index: 5; border-width: 0 0 1px; padding: 0;
  margin: calc(-1 * var(--mantine-spacing-xs)) 0 0;
  > .mantine-Paper-root { display: none; }
}
[data-scrollarea-viewport] img[src^="blob:"] {
  width: 100%; max-height: 23vh; object-fit: contain; object-position: left;
}
</style>"""
"""Style of the page, for what viser has no settings: the folder that contains it stays at the top
when its panel is scrolled, without border and title, and images are as wide as their panel."""

RELEASE = """
window.ratslamRelease ??= setInterval(() => {
  const scene = window.__viserMutable?.scene;
  if (!scene || scene.userData.drawnLines) return;
  scene.userData.drawnLines = new Set();
  scene.onBeforeRender = () => {
    const drawn = new Set();
    scene.traverse((one) => { if (one.isLine) drawn.add(one); });
    for (const one of scene.userData.drawnLines) {
      if (drawn.has(one)) continue;
      one.geometry.dispose();
      one.material.dispose();
    }
    scene.userData.drawnLines = drawn;
  };
}, 500);
"""
"""Script that frees the memory of lines that are no longer drawn. Viser (1.1) frees only the
meshes of a removed glTF node, so that a page would keep every map that it has ever drawn."""

PAGE = f'{STYLE}<img alt="" hidden src="data:," onerror="{escape(RELEASE)}">'
"""HTML for the time control. Scripts in inserted HTML do not run; the handler of an image does."""
