defmodule Aerie.Vehicle.Sampling.Change do
  @moduledoc """
  A value when it differs from the one given last. One that differs too early is held until the period is over, unless it
  changed back by then.
  """
  @behaviour Aerie.Vehicle.Sampling

  alias Aerie.Vehicle.Sampling
  alias Aerie.Vehicle.Sampling.Gate

  @impl Sampling
  def new(_group, settings, period_us), do: Gate.new(period_us, Sampling.refresh_us(settings))

  @impl Sampling
  def push(gate, at, data), do: Gate.push(gate, at, data, &!=/2)

  @impl Sampling
  def expire(gate, now), do: Gate.expire(gate, now)
end
