defmodule Aerie.Control.Policy.Memory.RecentCommands do
  @moduledoc """
  Which source commanded a vehicle last, through `Aerie.Control.Commands` or by raw MAVLink. Parts that change vehicles on their own
  initiative, such as the shadow, look here first.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Policy.Intent

  # PX4 wants 2 Hz.
  @setpoint_ms 500

  @typedoc "`at` in unix microseconds."
  @type t :: %{at: integer(), source: String.t(), type: String.t()}

  @doc "An allowed command is on its way to a vehicle. Requests for messages only are not noted."
  @spec note(Names.gateway(), vehicle :: String.t(), source :: String.t(), Intent.t()) :: :ok
  def note(_gateway, _vehicle, _source, %{permission: :telemetry}), do: :ok

  def note(gateway, vehicle, source, facts) do
    note = %{at: System.os_time(:microsecond), source: source, type: facts.type}
    Store.remember(gateway, {:commanded, vehicle}, note)
  end

  @doc "A set-point is on its way to a vehicle, and counts for so many milliseconds."
  @spec setpoint(Names.gateway(), vehicle :: String.t(), counts_ms :: non_neg_integer()) :: :ok
  def setpoint(gateway, vehicle, counts_ms \\ @setpoint_ms) do
    now = System.monotonic_time(:millisecond)

    {since, until} =
      case Store.recall(gateway, {:setpoints, vehicle}) do
        {since, until} when now <= until -> {since, until}
        _none_or_silent -> {now, now}
      end

    Store.remember(gateway, {:setpoints, vehicle}, {since, max(until, now + counts_ms)})
  end

  @doc "For how long set-points have come without a gap (ms); nil if none come."
  @spec setpoints_ms(Names.gateway(), vehicle :: String.t()) :: non_neg_integer() | nil
  def setpoints_ms(gateway, vehicle) do
    now = System.monotonic_time(:millisecond)

    case Store.recall(gateway, {:setpoints, vehicle}) do
      {since, until} when is_integer(since) and now <= until -> now - since
      _none_or_silent -> nil
    end
  end

  @doc "The last command of a vehicle; nil for none since the gateway was started."
  @spec last(Names.gateway(), vehicle :: String.t()) :: t() | nil
  def last(gateway, vehicle), do: Store.recall(gateway, {:commanded, vehicle})
end
