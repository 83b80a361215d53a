"""Questions of the routes to the daemon (docs/control.md)."""

from collections.abc import Mapping, Sequence

from faultline.service.core.records.fault import Fault
from faultline.service.protocol.answers import Erased, FaultDetail, FaultList, RecordPage, ServiceState
from faultline.service.protocol.errors import GarbledError, RefusedError
from faultline.service.protocol.live import FaultMeaning, SystemDescription
from faultline.service.protocol.questions import Question
from faultline.service.protocol.records import RecordError
from faultline.service.web.asking import SharedControl
from faultline.service.web.problems import RequestError
from faultline.service.web.queries import Page, Part
from faultline.service.web.ring import told


class Vehicle(SharedControl):
    """The daemon, asked over its control socket; every method raises what `ask` does."""

    async def state(self) -> ServiceState:
        """Return the daemon's state."""
        return await self.ask(Question(ask="state"), ServiceState)

    async def faults(self, system: str | None = None) -> Sequence[Fault]:
        """Return the remembered faults, of one system or of all."""
        memory = await self.ask(Question(ask="faults"), FaultList)
        return [fault for fault in memory.faults if system in (None, fault.system)]

    async def systems(self) -> list[str]:
        """Return the names of watched systems, then of others with remembered faults."""
        state, faults = await self.state(), await self.faults()
        return [*dict.fromkeys([*(each.name for each in state.systems), *(each.system for each in faults)])]

    async def fault(self, system: str, number: int) -> FaultDetail:
        """Return one of its faults; raises RequestError if it has none of that number."""
        found = await self.ask(Question(ask="fault", number=number), FaultDetail)
        if found.fault.system != system:
            raise RequestError(404, "unknown", f"fault {number} is none of {system!r}")
        return found

    async def meanings(self, system: str) -> Mapping[str, FaultMeaning]:
        """Return what its faults' names mean; nothing if it is not watched any more."""
        try:
            names = await self.ask(Question(ask="system", name=system), SystemDescription)
        except RefusedError as error:
            if error.code != "unknown":
                raise
            return {}
        return {each.name: each for each in names.faults}

    async def description(self, system: str) -> Mapping[str, object]:
        """Return what all its names mean, as the daemon answers."""
        return await self.ask(Question(ask="system", name=system), dict[str, object])

    async def records(self, page: Page) -> RecordPage:
        """Return a page of records."""
        before = page.before if page.after is None else None
        question = Question(ask="records", count=page.most, after=page.after, before=before)
        found = await self.ask_alone(question, RecordPage)
        if page.after is None or page.before is None:
            return found
        try:
            return RecordPage(records=[line for line in found.records if told(bytes(line)).seq < page.before])
        except RecordError as error:
            raise GarbledError(f"a record: {error}") from error

    async def history(self, system: str, part: Part) -> Mapping[str, object]:
        """Return ticks of a finished recording, as columns."""
        question = Question(ask="history", name=system, after=part.after, before=part.before, count=part.most)
        return await self.ask_alone(question, dict[str, object])

    async def erase(self, number: int) -> None:
        """Erase a fault: on return that is on the disk."""
        erased = await self.clear(Question(ask="clear", number=number), Erased)
        if number not in erased.cleared:
            raise GarbledError(f"fault {number} is not among those that were cleared")

    async def erase_all(self, system: str) -> None:
        """Erase all remembered faults of a system; at once, with the overflow flag, if there is no other."""
        if await self.systems() == [system]:
            await self.clear(Question(ask="clear"), Erased)
            return
        for fault in await self.faults(system):
            try:
                await self.erase(fault.number)
            except RefusedError as error:
                if error.code != "unknown":  # it has aged, or somebody else has cleared it
                    raise
