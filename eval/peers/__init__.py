"""Production renderers as peers: what their adaptive sampling gains over their own uniform sampling.

A peer runs in a process of its own (:mod:`.process`), by the modules in `workers`, and renders what :mod:`.scene`
describes. :mod:`.study` compares. Blender's Cycles needs the package ``bpy``, LuxCore ``pyluxcore``; both may be in
another Python than this one, as in an environment made by ``python3.11 -m venv peers``.
"""
