"""The figures of one evaluation: frozen records; ``None`` where there was nothing to measure."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

from queuetail.types import Floats, Ints


class Truth(IntEnum):
    """What the truth says of the queue at one time."""

    FREE = 0  # no queue
    IN_VIEW = 1  # its end is in the picture
    BEYOND_VIEW = 2  # its end is upstream of the picture
    HIDDEN = 3  # its end is downstream of the picture or behind an obstacle: nothing is judged


class Answer(IntEnum):
    """What the run said at one time; ``NONE`` where it has no row near that time."""

    NONE = 0
    CLEAR = 1
    QUEUED = 2
    BEYOND_VIEW = 3
    UNKNOWN = 4


@dataclass(frozen=True, slots=True)
class Timeline:
    """Truth and run side by side, one entry per row of the truth within the run's times."""

    t_s: Floats
    truth: Ints  # codes of Truth
    truth_station_m: Floats  # NaN where there is no queue
    answer: Ints  # codes of Answer
    run_station_m: Floats  # NaN where the run gives no position
    run_offset_m: Floats  # metres to the left of the truth's axis
    run_sigma_m: Floats
    strict_m: Floats  # signed error against the truth of the same time, NaN where not judged
    tolerant_m: Floats  # signed error against the nearest truth within the window


@dataclass(frozen=True, slots=True)
class EoqErrors:
    """Errors of the EOQ's station in metres; a positive bias is downstream of the truth."""

    samples: int
    bias_m: float | None  # median of the signed error
    median_m: float | None
    p95_m: float | None
    max_m: float | None
    inside_1_sigma: float | None  # share of the samples that state a sigma
    inside_2_sigma: float | None


@dataclass(frozen=True, slots=True)
class AnswerShares:
    """Which answers the run gave during one state of the truth, as shares of its samples."""

    samples: int
    queued: float | None
    beyond_view: float | None
    clear: float | None
    unknown: float | None
    no_answer: float | None


@dataclass(frozen=True, slots=True)
class Answers:
    """Right and wrong answers; `tolerant` excuses what the truth in the window would make right."""

    queue_in_view: AnswerShares
    queue_beyond_view: AnswerShares
    no_queue: AnswerShares
    missed_strict: float | None
    missed_tolerant: float | None
    false_strict: float | None
    false_tolerant: float | None
    unknown: float | None  # share of all samples
    no_answer: float | None


@dataclass(frozen=True, slots=True)
class Episode:
    """One queue of the truth, from its first to its last sample, and how late the run was."""

    start_s: float
    end_s: float
    found: bool
    onset_delay_s: float | None
    dissolve_delay_s: float | None  # None too where the truth's queue still stands at the end


@dataclass(frozen=True, slots=True)
class Episodes:
    """All queues of the truth; `worst` is the delay that is farthest from zero."""

    episodes: tuple[Episode, ...]
    missed: int
    false: int  # queues of the run that overlap no queue of the truth
    onset_median_s: float | None
    onset_worst_s: float | None
    dissolve_median_s: float | None
    dissolve_worst_s: float | None


@dataclass(frozen=True, slots=True)
class VehicleFigures:
    """Detection, tracking, place and speed of vehicles, in ground metres within `gate_m`."""

    gate_m: float
    instants: int
    truth_vehicles: int
    run_tracks: int
    pairs: int
    recall: float | None
    precision: float | None
    hota: float | None
    det_a: float | None
    ass_a: float | None
    idf1: float | None
    mota: float | None
    id_switches: int
    geolocation_median_m: float | None
    geolocation_p95_m: float | None
    along_bias_m: float | None  # median, positive downstream of the truth
    left_bias_m: float | None  # median, positive to the left of the truth
    speed_rmse_mps: float | None
    speed_bias_mps: float | None  # mean, positive where the run is faster


@dataclass(frozen=True, slots=True)
class ApproachChoice:
    """Which approach of the run was compared with the truth, and why that one."""

    name: str | None  # None where no approach of the run belongs to the truth's road
    why: str
    others: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Span:
    """The times compared, and which share of the truth's rows they cover."""

    start_s: float
    end_s: float
    truth_covered: float


@dataclass(frozen=True, slots=True)
class Evaluation:
    """A run measured against the truth of its flight."""

    run: str
    truth: str
    approach: ApproachChoice
    span: Span
    strict: EoqErrors
    tolerant: EoqErrors
    eoq_left_bias_m: float | None  # median offset of the run's EOQ to the left of the truth's axis
    answers: Answers
    episodes: Episodes
    vehicles: VehicleFigures
    timeline: Timeline
