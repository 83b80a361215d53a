"""The verdict of a finished log: a fault was found, there is none, or why neither can be said."""

from collections.abc import Sequence

from faultline.service.core.decision.decision import Decision
from faultline.service.core.manifest import Manifest
from faultline.service.core.records.event import Diagnosis, Event
from faultline.service.core.signals.decode import DecodeTable


class Verdict:
    """Follows the events of a log. `blind` are the tests that never could tell so far.

    `diagnoses` are those of the last fault that was found and not withdrawn, as they stood last.
    """

    def __init__(self, manifest: Manifest) -> None:
        self._signals = [channel.signal for channel in manifest.inputs]
        self._healed = self._stands = False
        self.blind = {generator.test for generator in manifest.generators}
        self.diagnoses: Sequence[Diagnosis] = ()

    def add(self, event: Event) -> None:
        """Take the next event."""
        if event.diagnoses:
            self._stands, self.diagnoses = True, event.diagnoses
        elif event.transition in ("healed", "withdrawn"):  # the latter was no fault: its samples are doubted
            healed = self._stands and event.transition == "healed"
            self._healed, self._stands = self._healed or healed, False
            if event.transition == "withdrawn" and not self._healed:
                self.diagnoses = ()
        self.blind &= set(event.cannot_tell)

    def found(self, decision: Decision) -> bool:
        """Return whether there was a fault, at the log's end too: what is decided may not be in an event yet."""
        if decision.diagnoses:
            self.diagnoses = decision.diagnoses
        return self._healed or self._stands or bool(decision.diagnoses)

    def why_open(self, decision: Decision, table: DecodeTable) -> str:
        """Return why a log without a fault does not show that there is none, with a remedy; "" where it does."""
        if second := second_senders(table):
            return f"{second}, so no alarm is no all-clear; give a log without them"
        if self.blind:
            strangers = "".join(f"; {text}" for text in table.strangers())
            return (
                f"{' '.join(sorted(self.blind))} could never tell, so no alarm is no all-clear; give a longer log "
                f"that has {', '.join(self._signals)}, within their operating ranges{strangers}"
            )
        if decision.is_open:
            return "ends while something is suspected and not yet confirmed or dismissed; give a longer log"
        if decision.alarm:
            return (
                f"ends while {' '.join(decision.alarm)} alarms, which is taken for the drive's "
                "baseline: no fault was confirmed, and none is ruled out; record another drive"
            )
        return ""


def second_senders(table: DecodeTable) -> str:
    """Return the messages of which frames came far too early for one sender, or from several; "" if there are none."""
    early = ", ".join(f"{count} of {name}" for name, count in table.rejected.early.items())
    found = table.strangers() if table.rejected.unclear else []
    if early:
        why = "a second one, or two buses; they are not believed"
        found.insert(0, f"frames came far too early for one sender ({early}): {why}")
    return "; ".join(found)
