defmodule Aerie.Vehicle.Detector.Batteries do
  @moduledoc """
  When batteries are low or critical: by their charge state, or by what remains in them.

  Each battery has its own level and its own events, whose `battery` (id), `remaining`, `voltage` and `charge_state` are of
  one message of it. The first one is followed through a change of its source: SYS_STATUS shows it until BATTERY_STATUS
  does, without its id.
  """

  alias Aerie.Vehicle.{Detector, State}

  # A battery has to recover by this much before it can be low again.
  @recovered 0.05

  @typedoc "What is followed of one: `id` is `:unknown` where the message does not say."
  @type battery :: %{id: 0..255 | :unknown, remaining: float() | nil, charge_state: String.t() | nil}
  @type level :: :ok | :low | :critical

  @doc "The part of a digest that is about batteries: the vehicle's own values and its further batteries."
  @spec digest(State.t()) :: map()
  def digest(state) do
    group = State.data(state, :battery)
    first = State.Power.first(group.batteries || [])

    others =
      for one <- group.batteries || [], one != first, do: Map.take(one, [:id, :remaining, :charge_state])

    charge_state = if group.id, do: first.charge_state

    # No key becomes nil again, for unknown values keep what was known; this one goes with the source.
    known =
      if group.id || group.remaining,
        do: %{battery: group.id || :unknown, charge_state: charge_state || "UNKNOWN"}

    Map.merge(%{remaining: group.remaining, batteries: others}, known || %{})
  end

  @doc "The voltages now, by id. They change all the time, so that they are in no digest."
  @spec voltages(State.t()) :: %{(0..255 | :unknown) => float() | nil}
  def voltages(state) do
    group = State.data(state, :battery)

    for(one <- group.batteries || [], into: %{}, do: {one.id, one.voltage})
    |> Map.put(group.id || :unknown, group.voltage)
  end

  @doc "Steps of the detector (`t:Aerie.Vehicle.Detector.step/0`)."
  @spec events(digest :: map(), Detector.t()) :: [Detector.step()]
  def events(now, detector) do
    own = %{id: now[:battery] || :unknown, remaining: now[:remaining], charge_state: now[:charge_state]}

    {steps, _levels} =
      Enum.flat_map_reduce(
        [{:own, own} | for(one <- now[:batteries] || [], do: {one.id, one})],
        detector.battery,
        fn
          {key, battery}, levels ->
            was = Map.get(levels, key, :ok)
            level = level(battery, was, detector)
            levels = Map.put(levels, key, level)
            {steps(was, level, data(battery, now), battery: levels), levels}
        end
      )

    steps
  end

  defp steps(:ok, :low, data, changes), do: [{"battery.low", data, changes}]

  defp steps(:ok, :critical, data, changes),
    do: [{"battery.low", data, []}, {"battery.critical", data, changes}]

  defp steps(:low, :critical, data, changes), do: [{"battery.critical", data, changes}]
  defp steps(same, same, _data, _changes), do: []
  defp steps(_was, _better, _data, changes), do: [{nil, %{}, changes}]

  defp data(battery, now) do
    %{
      "battery" => if(battery.id != :unknown, do: battery.id),
      "remaining" => battery.remaining,
      "voltage" => now[:voltages][battery.id],
      "charge_state" => if(battery.charge_state != "UNKNOWN", do: battery.charge_state)
    }
  end

  # The level with hysteresis: a level that was reached is left only well above its threshold.
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
