"""The options that name events."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated

from robodyn.cli.files import output_file
from robodyn.cli.options import Text, option
from robodyn.errors import InputError
from robodyn.mechanics.mechanism import Mechanism
from robodyn.simulation.simulation import UNTIL, watched_events

if TYPE_CHECKING:
    from robodyn.events.watch import EventWatch

_UNTIL = "Ends the run when this becomes true, as q1 > 90deg, or passes zero."
EVENT = "Tells when EXPR passes zero, or becomes true; may be repeated."
_EVENTS = "Writes event,t,q1..,qd1.. of each event as CSV."


@dataclass(eq=False, repr=False)
class EventOptions:
    """What to look for on the way."""

    until: Text = option(_UNTIL, "EXPR")
    event: list[str] | None = option(EVENT, "NAME=EXPR")
    events: Annotated[Text, output_file("--events", help=_EVENTS)] = None

    def watch(self, mechanism: Mechanism, t_end: float) -> EventWatch | None:
        """What watches the run; InputError naming the option that is none."""
        given = named_events(mechanism, self.event or [])
        try:
            watch = watched_events(mechanism, given, self.until, t_end)
        except InputError as error:
            if error.where:
                error.where = f"--{error.where}"
            raise
        if watch is None and self.events is not None:
            if not mechanism.switches:
                raise InputError("--events", limit="there are none: give --event or --until")
            from robodyn.events.watch import EventWatch

            watch = EventWatch([], t_end)
        return watch


def named_events(mechanism: Mechanism, texts: Iterable[str]) -> dict[str, str]:
    """The expressions of NAME=EXPR by their names; InputError naming the option that is none."""
    given: dict[str, str] = {}
    for text in texts:
        name, sign, expression = (part.strip() for part in text.partition("="))
        if not (sign and name and expression) or expression.startswith("="):
            limit = "must be NAME=EXPR, such as apex=qd1 or high='q1 > 90deg'"
            raise InputError("--event", value=text, limit=limit)
        if name in given or name == UNTIL:
            limit = "each event needs a name of its own"
            raise InputError("--event", value=name, limit=limit)
        given[name] = expression
    if not given:
        return given
    from robodyn.events.functions import event_functions

    try:
        event_functions(mechanism, given)
    except InputError as error:
        error.where = f"--{error.where}" if error.where else "--event"
        raise
    return given
