defmodule Aerie.Vehicle.Detector.Batteries do
  @moduledoc """
  Whether batteries are low or critical, by their charge state or the charge that remains.

  Each battery has its own level and its own events, whose `battery` (id), `remaining`, `voltage` and `charge_state` come from
  one message about it. The first battery keeps its level when its source changes: SYS_STATUS shows it, without its id, until
  BATTERY_STATUS does.
  """

  alias Aerie.Vehicle.{Detector, State}
  alias Aerie.Vehicle.Detector.Step

  # A battery has to recover by this much before it can be low again.
  @recovered 0.05

  @typedoc "`id` is `:unknown` if the message does not say."
  @type battery :: %{id: 0..255 | :unknown, remaining: float() | nil, charge_state: String.t() | nil}
  @type level :: :ok | :low | :critical

  @doc "The part of a digest about batteries: the group's own values, and the other batteries."
  @spec digest(State.t()) :: map()
  def digest(state) do
    group = State.data(state, :battery)
    first = State.Battery.first(group.batteries || [])

    others =
      for one <- group.batteries || [], one != first, do: Map.take(one, [:id, :remaining, :charge_state])

    charge_state = if group.id && first, do: first.charge_state

    # A digest's nil keeps the last known value. What has to change with the source is never nil.
    known =
      if group.id || group.remaining do
        %{
          battery: group.id || :unknown,
          remaining: group.remaining || :unknown,
          charge_state: charge_state || "UNKNOWN"
        }
      end

    Map.merge(%{remaining: nil, batteries: others}, known || %{})
  end

  @doc "The voltages by battery id. They change all the time, so they are not in the digest."
  @spec voltages(State.t()) :: %{(0..255 | :unknown) => float() | nil}
  def voltages(state) do
    group = State.data(state, :battery)

    for(one <- group.batteries || [], into: %{}, do: {one.id, one.voltage})
    |> Map.put(group.id || :unknown, group.voltage)
  end

  @spec steps(digest :: map(), Detector.t()) :: [Step.t()]
  def steps(now, detector) do
    remaining = if now[:remaining] != :unknown, do: now[:remaining]
    own = %{id: now[:battery] || :unknown, remaining: remaining, charge_state: now[:charge_state]}

    {steps, _levels} =
      Enum.flat_map_reduce(
        [{:own, own} | for(one <- now[:batteries] || [], do: {one.id, one})],
        detector.battery,
        fn
          {key, battery}, levels ->
            was = Map.get(levels, key, :ok)
            level = level(battery, was, detector)
            levels = Map.put(levels, key, level)
            {change(was, level, data(battery, now), battery: levels), levels}
        end
      )

    steps
  end

  defp change(:ok, :low, data, changes), do: [Step.event("battery.low", data, changes)]

  defp change(:ok, :critical, data, changes),
    do: [Step.event("battery.low", data), Step.event("battery.critical", data, changes)]

  defp change(:low, :critical, data, changes), do: [Step.event("battery.critical", data, changes)]
  defp change(same, same, _data, _changes), do: []
  defp change(_was, _better, _data, changes), do: [Step.change(changes)]

  defp data(battery, now) do
    %{
      "battery" => if(battery.id != :unknown, do: battery.id),
      "remaining" => battery.remaining,
      "voltage" => now[:voltages][battery.id],
      "charge_state" => if(battery.charge_state != "UNKNOWN", do: battery.charge_state)
    }
  end

  # Nothing is known of it now.
  defp level(%{remaining: nil, charge_state: state}, was, _detector) when state in [nil, "UNKNOWN"], do: was

  # With hysteresis: a level is left only well above its threshold.
  defp level(battery, was, detector) do
    remaining = battery.remaining || 1.0
    critical = detector.battery_critical + if(was == :critical, do: @recovered, else: 0)
    low = detector.battery_low + if(was == :ok, do: 0, else: @recovered)

    cond do
      battery.charge_state in ["CRITICAL", "EMERGENCY", "FAILED"] or remaining <= critical -> :critical
      battery.charge_state == "LOW" or remaining <= low -> :low
      true -> :ok
    end
  end
end
