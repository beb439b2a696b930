"""What a station is made of: made by `edge.gateway.build`, used by its loop."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from edge.core.contact.settings import ContactSettings
from edge.core.ports import Clock
from edge.core.sink_context import Place
from edge.gateway.acquisition import Acquisition
from edge.gateway.admission import SelectByCode
from edge.gateway.black_box import BlackBox
from edge.gateway.bundle_stage import BundleStage
from edge.gateway.digital_io.station_io import StationIo
from edge.gateway.free_space import FreeSpace
from edge.gateway.gel_proof_watch import GelProofWatch
from edge.gateway.loop_calls import LoopCalls
from edge.gateway.overview import Overview
from edge.gateway.part_selection import PartSelection
from edge.gateway.press_stage import PressStage
from edge.gateway.reference_guard import ReferenceGuard
from edge.gateway.sensing_watch import SensingWatch
from edge.gateway.snapshots import Snapshots
from edge.gateway.status import StationStatus
from edge.messaging.publisher import Publisher
from edge.messaging.retained_state import RetainedState
from edge.store.press_store import Store
from edge.store.reference_files import ReferenceFolder

__all__ = ["Parts"]


@dataclass(frozen=True)
class Parts:
    """The parts of a station, built and not yet started. Their builder closes them.

    calls: of other threads, with the loop that has these parts. stages: what a press goes through, given how a part is
    selected by its code. reference: None where a gauge study says what presses are for. stats_s: between two reports.
    """

    selection: PartSelection
    stage: BundleStage
    contact: ContactSettings
    place: Place
    store: Store
    free_space: FreeSpace
    references: ReferenceFolder
    retained_state: RetainedState
    publisher: Publisher
    status: StationStatus
    acquisition: Acquisition
    calls: LoopCalls[Any]
    clock: Clock
    io: StationIo
    snapshots: Snapshots
    black_box: BlackBox
    reference: ReferenceGuard | None
    proof: GelProofWatch
    sensing: SensingWatch
    stages: "Callable[[Parts, SelectByCode], Sequence[PressStage]]"
    overview: Overview | None = None
    stats_s: float = 10.0
