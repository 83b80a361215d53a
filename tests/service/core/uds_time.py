"""The dosing system's operating modes by index, and how long things last for it in ticks."""

from faultline.service.core.decision import decision, telling, window
from faultline.service.core.detectors import bank
from faultline.service.core.signals.modes import EDGE
from faultline.service.core.time_scale import TimeScale

TIME = TimeScale(period_s=0.2, settling_s=20.0)
IDLE, PARTIAL, MAXIMUM = range(EDGE + 1, EDGE + 4)

HEALED_TICKS, LINGER_TICKS = TIME.ticks(decision.HEALED), TIME.ticks(decision.LINGER)
RANKING_PERIOD, VAIN_TICKS = TIME.ticks(decision.RANKING), TIME.ticks(decision.VAIN)
UNSEEN_TICKS, FROZEN_TICKS = TIME.ticks(decision.UNSEEN), TIME.ticks(bank.FROZEN)
PART_TICKS, SETTLE_TICKS = TIME.ticks(window.PART), TIME.ticks(telling.SETTLE)
