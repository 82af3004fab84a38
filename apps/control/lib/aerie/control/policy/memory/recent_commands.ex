defmodule Aerie.Control.Policy.Memory.RecentCommands do
  @moduledoc """
  Which source commanded a vehicle last, through `Aerie.Control.Commands` or by raw MAVLink. Parts that change vehicles on their own
  initiative, such as the shadow, look here first.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Control.Policy.Intent

  # PX4 wants 2 Hz.
  @setpoint_ms 500
  # So many are kept of a vehicle that end its flight, and of the others. A stream has one place.
  @kept 4
  @sticks ~w(rc_override manual_control)

  @typedoc "`at` in unix microseconds."
  @type t :: %{at: integer(), source: String.t(), type: String.t()}

  @typedoc "The same of one that may have moved a vehicle, or ends a flight; `us`: when it was given (monotonic)."
  @type moved :: %{
          at: integer(),
          source: String.t(),
          type: String.t(),
          id: String.t() | nil,
          us: integer(),
          ends?: boolean()
        }

  @doc """
  An allowed command is on its way to a vehicle. Requests for messages only are not noted. `id` is that of a command of
  this gateway, nil for raw MAVLink, and `us` when it was given (monotonic).
  """
  @spec note(Names.gateway(), String.t(), String.t(), Intent.t(), id :: String.t() | nil, us :: integer()) ::
          :ok
  def note(gateway, vehicle, source, facts, id \\ nil, us \\ System.monotonic_time(:microsecond))
  def note(_gateway, _vehicle, _source, %{permission: :telemetry}, _id, _us), do: :ok

  def note(gateway, vehicle, source, facts, id, us) do
    note = %{at: System.os_time(:microsecond), source: source, type: facts.type}
    moved(gateway, vehicle, facts, Map.merge(note, %{id: id, us: us, ends?: facts.ends_flight?}))
    Store.remember(gateway, {:commanded, vehicle}, note)
  end

  defp moved(_gateway, _vehicle, %{moves?: false, ends_flight?: false}, _note), do: :ok
  # Ground stations with a joystick send them all the time, whether anybody steers or not.
  defp moved(_gateway, _vehicle, %{type: type}, %{id: nil}) when type in @sticks, do: :ok

  # Each has a place of its own, so that of two at the same moment none is lost.
  defp moved(gateway, vehicle, %{type: type}, %{ends?: ends?} = note) do
    place =
      if String.starts_with?(type, "setpoint_") or type in @sticks,
        do: :stream,
        else: {ends?, rem(Store.count(gateway, {:vehicle, vehicle, {:moved, ends?}}), @kept)}

    Store.remember(gateway, {:moved, vehicle, place}, note)
  end

  @doc "The last commands that may have moved a vehicle, or end its flight, in no order."
  @spec moved(Names.gateway(), vehicle :: String.t()) :: [moved()]
  def moved(gateway, vehicle) do
    places = [:stream | for(ends? <- [true, false], n <- 0..(@kept - 1), do: {ends?, n})]
    for place <- places, note = Store.recall(gateway, {:moved, vehicle, place}), do: note
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
