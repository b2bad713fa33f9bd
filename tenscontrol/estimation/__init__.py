"""State estimation: sensors, and a Kalman filter in reduced coordinates."""

from tenscontrol.estimation.kalman_filter import Estimate, FilterStatistics, KalmanFilter
from tenscontrol.estimation.sensors import KINDS, Sensors

__all__ = ["KINDS", "Estimate", "FilterStatistics", "KalmanFilter", "Sensors"]
