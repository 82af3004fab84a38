defmodule Aerie.Vehicle.Events.Detector.Batteries do
  @moduledoc """
  Whether batteries are low or critical, by their charge state or the charge that remains.

  Each battery has its own level and its own events, whose `battery` (id), `remaining`, `voltage` and `charge_state` come from
  one message about it. The first battery keeps its level when its source changes: SYS_STATUS shows it, without its id, until
  BATTERY_STATUS does. A level that is left well above its threshold, or with the battery itself, ends with
  `battery.recovered`.
  """

  alias Aerie.Vehicle.State
  alias Aerie.Vehicle.Events.Detector
  alias Aerie.Vehicle.Events.Detector.Step

  # A battery has to recover by this much before it can be low again.
  @recovered 0.05

  @typedoc "`id` is `:unknown` if the message does not say."
  @type battery :: %{id: 0..255 | :unknown, remaining: float() | nil, charge_state: String.t() | nil}
  @type level :: :ok | :low | :critical
  @typedoc "By id, `:own` while that is not known: the level, and since when."
  @type levels :: %{(0..255 | :own) => {level(), since :: integer()}}

  @doc "The part of a digest about batteries: the group's own values, and the other batteries."
  @spec digest(State.t()) :: map()
  def digest(state) do
    group = State.data(state, :battery)
    first = State.Groups.Battery.first(group.batteries || [])

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

  @spec steps(digest :: map(), Detector.t(), at :: integer()) :: [Step.t()]
  def steps(now, detector, at) do
    known = batteries(now, detector.battery)
    levels = named(detector.battery, known)

    gone =
      for {key, {level, since}} <- levels, level != :ok, not List.keymember?(known, key, 0), do: {key, since}

    levels = Map.take(levels, Enum.map(known, &elem(&1, 0)))

    {steps, levels} =
      Enum.flat_map_reduce(known, levels, fn {key, battery}, levels ->
        {was, since} = Map.get(levels, key, {:ok, at})
        level = level(battery, was, detector)
        data = data(battery, now)
        lasted = %{"level" => Atom.to_string(level), "duration" => Step.seconds(since, at)}
        since = if level == was, do: since, else: at
        {change(was, level, data, Map.merge(data, lasted)), Map.put(levels, key, {level, since})}
      end)

    ended =
      for {key, since} <- gone do
        data = data(%{id: if(key == :own, do: :unknown, else: key), remaining: nil, charge_state: nil}, now)
        lasted = %{"voltage" => nil, "level" => "gone", "duration" => Step.seconds(since, at)}
        Step.event("battery.recovered", Map.merge(data, lasted))
      end

    if levels == detector.battery, do: [], else: steps ++ ended ++ [Step.change(battery: levels)]
  end

  @doc "The batteries that are low or critical now; the first one is the subject nil."
  @spec conditions(Detector.t()) :: [Detector.condition()]
  def conditions(detector) do
    known = batteries(detector.last, detector.battery)
    first = detector.battery |> Map.keys() |> Enum.min(fn -> nil end)

    for {key, {level, since}} <- detector.battery, level != :ok, {^key, battery} <- known do
      measured = level(%{battery | charge_state: nil, remaining: battery.remaining || 1.0}, level, detector)
      said = if measured != level and battery.charge_state != "UNKNOWN", do: battery.charge_state
      data = battery |> data(detector.last) |> Map.merge(%{"several" => length(known) > 1, "said" => said})
      %{type: "battery.#{level}", subject: if(key != first, do: key), since: since, data: data}
    end
  end

  # The group's own battery and the others, each with the key of its level. Without an id it is the first one.
  defp batteries(digest, levels) do
    remaining = if digest[:remaining] != :unknown, do: digest[:remaining]
    id = digest[:battery] || :unknown
    key = if id == :unknown, do: levels |> Map.keys() |> Enum.min(fn -> :own end), else: id
    own = %{id: id, remaining: remaining, charge_state: digest[:charge_state]}
    [{key, own} | for(one <- digest[:batteries] || [], one.id != key, do: {one.id, one})]
  end

  # The id of the first battery became known.
  defp named(%{own: level} = levels, [{key, _own} | _others]) when key != :own,
    do: levels |> Map.delete(:own) |> Map.put_new(key, level)

  defp named(levels, _batteries), do: levels

  defp change(:ok, :low, data, _ended), do: [Step.event("battery.low", data)]

  defp change(:ok, :critical, data, _ended),
    do: [Step.event("battery.low", data), Step.event("battery.critical", data)]

  defp change(:low, :critical, data, _ended), do: [Step.event("battery.critical", data)]
  defp change(same, same, _data, _ended), do: []
  defp change(_was, _better, _data, ended), do: [Step.event("battery.recovered", ended)]

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
