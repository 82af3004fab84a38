defmodule Aerie.Vehicle.State.Sampling.Change do
  @moduledoc """
  Publishes a value that differs from the last one. If the period is not over yet, the value is held until then, and dropped
  if it changes back.
  """
  @behaviour Aerie.Vehicle.State.Sampling

  alias Aerie.Vehicle.State.Sampling
  alias Aerie.Vehicle.State.Sampling.Gate

  @impl Sampling
  def new(_group, settings, period_us), do: Gate.new(period_us, Sampling.refresh_us(settings))

  @impl Sampling
  def push(gate, at, data), do: Gate.push(gate, at, data, &!=/2)

  @impl Sampling
  def expire(gate, now), do: Gate.expire(gate, now)
end
