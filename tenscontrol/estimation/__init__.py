"""State estimation: sensors, and a Kalman filter in reduced coordinates."""

from tenscontrol.estimation.kalman_filter import Estimate, FilterStatistics, KalmanFilter
from tenscontrol.estimation.observability_report import Observability
from tenscontrol.estimation.sensors import Sensors
from tenscontrol.estimation.smoother import SmoothedMotion

__all__ = [
    "Estimate",
    "FilterStatistics",
    "KalmanFilter",
    "Observability",
    "Sensors",
    "SmoothedMotion",
]
