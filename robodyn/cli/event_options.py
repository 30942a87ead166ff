"""The options that name events."""

from __future__ import annotations

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
        given: dict[str, str] = {}
        if self.event:
            from robodyn.events.functions import named_events

            given = named_events(mechanism, self.event, UNTIL)
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
