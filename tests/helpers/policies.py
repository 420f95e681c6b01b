"""Other numbers of the policy for one module, as long as a test lasts."""

from __future__ import annotations

from dataclasses import replace

from odt_plugins.engine.policy import POLICY


def set_policy(monkeypatch, module, **numbers):
    monkeypatch.setattr(module, "POLICY", replace(POLICY, **numbers))
