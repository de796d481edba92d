"""Plans of runs by the name of their method, and the names of methods of each kind, for tests."""

from __future__ import annotations

from svrgs_addon.finetune.methods import METHODS, method_named, paper_method
from svrgs_addon.finetune.plan import Plan, prune_plan, train_plan
from svrgs_addon.finetune.settings import Phase

LEARNED = [name for name, method in METHODS.items() if method.prunes and not method.ranks]
RANKED = [name for name, method in METHODS.items() if method.ranks]


def prune_settings(method: str, iterations: int, recovery: int, **more) -> Plan:
    return prune_plan(method_named(method), iterations, recovery, **more)


def train_settings(method: str, iterations: int, recovery: int, **more) -> Plan:
    return train_plan(
        paper_method() if method == "svr-paper" else method_named(method), iterations, recovery, **more
    )


def plan_of(method: str, phases: tuple[Phase, ...], **more) -> Plan:
    """With phases of the test's own."""
    return Plan(phases=phases, method=method_named(method), **more)
