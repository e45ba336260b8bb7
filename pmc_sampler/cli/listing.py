"""``pmc-sampler scenes`` and ``pmc-sampler renderers``: what there is."""

import argparse
import importlib
import json

from .optional import load


def scenes(options: argparse.Namespace) -> int:
    """The built-in scenes, each with a sentence on it."""
    module = load("pmc_sampler.scenes", "listing scenes", "all")
    rows = {name: module.describe(name) for name in module.names()}
    if options.json:
        print(json.dumps({"scenes": [{"name": name, "description": text} for name, text in rows.items()]}, indent=2))
        return 0
    width = max((len(name) for name in rows), default=0)
    for name, text in rows.items():
        print(f"{name:{width}}  {text}")
    return 0


def renderers(options: argparse.Namespace) -> int:
    """The renderers: what each runs on, or why it cannot run and what to install."""
    found = importlib.import_module("pmc_sampler.adapters").available()
    if options.json:
        rows = [
            {"name": item.name, "runs": item.runs, "detail": item.detail, "trouble": item.trouble} for item in found
        ]
        print(json.dumps({"renderers": rows}, indent=2))
        return 0
    width = max((len(item.name) for item in found), default=0)
    for item in found:
        print(f"{item.name:{width}}  {item.detail if item.runs else f'cannot run here: {item.trouble}'}")
    return 0
