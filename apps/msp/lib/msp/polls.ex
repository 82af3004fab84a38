defmodule Msp.Polls do
  @moduledoc """
  What a flight controller is asked by itself, and how often: a table for each firmware. The message that is overdue most, measured
  in its own period, comes first, so that a slow line makes all of them rarer alike.

  A MAVLink client's rate for a message becomes the rate of the requests that it is made of.
  """

  alias MavCodec.Messages, as: M

  # {message, arguments, period in ms}
  @table %{
    betaflight: [
      {"STATUS_EX", %{}, 200},
      {"ATTITUDE", %{}, 200},
      {"RAW_GPS", %{}, 500},
      {"ALTITUDE", %{}, 500},
      {"BATTERY_STATE", %{}, 1000},
      {"ANALOG", %{}, 2000},
      {"RC", %{}, 1000},
      {"BOXIDS", %{}, 10_000}
    ],
    inav: [
      {"MSP2_INAV_STATUS", %{}, 200},
      {"ATTITUDE", %{}, 200},
      {"RAW_GPS", %{}, 500},
      {"ALTITUDE", %{}, 500},
      {"MSP2_INAV_ANALOG", %{}, 1000},
      {"RC", %{}, 1000},
      {"NAV_STATUS", %{}, 500},
      {"WP_GETINFO", %{}, 5000},
      {"MSP2_INAV_MISC2", %{}, 1000},
      {"SENSOR_STATUS", %{}, 2000},
      {"WP", %{number: 0}, 5000},
      {"BOXIDS", %{}, 10_000}
    ]
  }
  @made_of %{
    M.Heartbeat.id() => ["STATUS_EX", "MSP2_INAV_STATUS"],
    M.SysStatus.id() => ["STATUS_EX", "MSP2_INAV_STATUS"],
    M.Attitude.id() => ["ATTITUDE"],
    M.GpsRawInt.id() => ["RAW_GPS"],
    M.GlobalPositionInt.id() => ["RAW_GPS", "ALTITUDE"],
    M.BatteryStatus.id() => ["BATTERY_STATE", "MSP2_INAV_ANALOG"],
    M.RcChannels.id() => ["RC"]
  }
  @fastest_us 40_000
  # The status is the sign of life, whatever a client wants.
  @slowest_us 5_000_000

  defstruct polls: %{}

  @typedoc "By message: its arguments, its period and usual period (us), when it is due; nil once the vehicle has refused it."
  @type t :: %__MODULE__{polls: %{String.t() => map}}

  @doc "The polls of a firmware, all due."
  @spec new(Msp.Modes.firmware(), integer) :: t
  def new(firmware, now) do
    polls =
      for {name, arguments, ms} <- @table[firmware], into: %{} do
        {name, %{arguments: arguments, period: ms * 1000, usual: ms * 1000, due: now}}
      end

    %__MODULE__{polls: polls}
  end

  @doc "The message that is due at `now`, or when the next one will be."
  @spec next(t, integer) :: {:ask, String.t(), map} | {:at, integer} | :none
  def next(%__MODULE__{polls: polls}, _now) when polls == %{}, do: :none

  def next(%__MODULE__{polls: polls}, now) do
    {name, poll} = Enum.max_by(polls, fn {name, poll} -> {(now - poll.due) / poll.period, name} end)

    if poll.due <= now,
      do: {:ask, name, poll.arguments},
      else: {:at, polls |> Map.values() |> Enum.map(& &1.due) |> Enum.min()}
  end

  @doc "Whether one has been due for longer than its own period: whatever else there is to ask has to wait for it."
  @spec late?(t, integer) :: boolean
  def late?(%__MODULE__{polls: polls}, now),
    do: Enum.any?(polls, fn {_name, poll} -> now - poll.due > poll.period end)

  @doc "It was asked: it is due again a period later."
  @spec asked(t, String.t(), integer) :: t
  def asked(polls, name, now), do: update(polls, name, &%{&1 | due: max(&1.due, now - &1.period) + &1.period})

  @doc "The vehicle refused it, as a build without the part that it is about does: it is asked no more."
  @spec refused(t, String.t()) :: t
  def refused(%__MODULE__{polls: polls}, name), do: %__MODULE__{polls: Map.delete(polls, name)}

  defp update(%__MODULE__{polls: polls} = all, name, fun) do
    if is_map_key(polls, name), do: %{all | polls: Map.update!(polls, name, fun)}, else: all
  end

  @doc """
  The rate that clients want for a MAVLink message: the interval in us, 0 for the usual one. `:error` for a message that is not made
  here.
  """
  @spec interval(t, message_id :: non_neg_integer, us :: integer) :: {:ok, t} | :error
  def interval(polls, id, us) do
    case @made_of do
      %{^id => names} ->
        {:ok, Enum.reduce(names, polls, &update(&2, &1, fn poll -> %{poll | period: period(us, poll)} end))}

      _other ->
        :error
    end
  end

  defp period(0, poll), do: poll.usual
  defp period(us, _poll) when us < 0, do: @slowest_us
  defp period(us, _poll), do: us |> max(@fastest_us) |> min(@slowest_us)

  @doc "The present interval of a MAVLink message in us, nil for one that is not made here."
  @spec interval(t, message_id :: non_neg_integer) :: pos_integer | nil
  def interval(%__MODULE__{polls: polls}, id) do
    periods = for name <- Map.get(@made_of, id, []), poll = polls[name], do: poll.period
    Enum.max(periods, fn -> nil end)
  end
end
