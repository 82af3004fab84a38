defmodule Aerie.Vehicle.Snapshot.Readiness do
  @moduledoc """
  Whether a vehicle is ready to take off: point by point, each with a sentence for people and what to do. Pure.

  Its word is that of the worst point: one that is not ready, then one that is not known, then one to be checked. So a
  vehicle of which something is not known is never ready. A point that its firmware has nothing for is left out.
  """

  alias Aerie.Vehicle.{Firmware, Snapshot}
  alias Aerie.Vehicle.Snapshot.Arming
  alias Aerie.Vehicle.Snapshot.Readiness.Points

  @second 1_000_000
  @late_us 2 * @second
  # A value of which no newer one came is not known: slow links send each group every few seconds.
  @old_us 60 * @second
  @satellites 8
  @settled_s 30
  @reasons 8

  @typedoc "`:unknown`: what decides it is not known."
  @type state :: :ready | :check | :not_ready | :unknown
  @type point :: %{name: atom(), title: String.t(), state: state(), text: String.t(), todo: String.t() | nil}
  @type t :: %{state: state(), points: [point(), ...]}

  @typedoc """
    * `:now` - unix microseconds; `:links` - snapshots of the gateway's links; `:events` - its latest
    * `:aboard` - the state of its desired fields by path (docs/shadow.md), `:unseen` for one that nobody reports;
      without a desired plan there is none
    * `:holder` - who is in charge; `:viewer` - the name of the caller, `:anybody` for the answer that its holder gets
    * `:reserve` - the charge that it should have, `:floor` - that without which the policy refuses a take-off
  """
  @type beside :: %{
          now: integer(),
          links: [map()],
          events: [Aerie.Vehicle.Event.t()],
          aboard: %{String.t() => atom()},
          holder: String.t() | nil,
          viewer: String.t() | nil | :anybody,
          reserve: number(),
          floor: number() | nil
        }

  @doc "The state of a vehicle's snapshot, with its points in their fixed order."
  @spec of(Snapshot.t(), beside()) :: t()
  def of(vehicle, beside) do
    beside = Map.put(beside, :clock, Snapshot.now(vehicle, beside.links, beside.now))

    points =
      for {name, {title, todo}} <- Points.all(), {state, text} <- List.wrap(check(name, vehicle, beside)) do
        %{name: name, title: title, state: state, text: text, todo: if(state != :ready, do: todo)}
      end

    %{state: worst(points), points: points}
  end

  @doc "The points that are not ready, the worst first."
  @spec open(t()) :: [point()]
  def open(%{points: points}) do
    points |> Enum.reject(&(&1.state == :ready)) |> Enum.sort_by(&rank(&1.state), :desc)
  end

  defp worst(points), do: points |> Enum.map(& &1.state) |> Enum.max_by(&rank/1)
  defp rank(state), do: Enum.find_index(Points.states(), &(&1 == state))

  defp check(:link, %{status: :lost}, _beside), do: {:not_ready, "It is lost."}
  defp check(:link, %{status: :stale}, _beside), do: {:not_ready, "It is not heard at present."}

  defp check(:link, %{collision: %{}}, _beside), do: {:not_ready, "Others send under its id."}

  defp check(:link, %{high_latency: %{only?: true}}, _beside),
    do: {:check, "Only slow links reach it, such as a satellite's."}

  defp check(:link, vehicle, %{links: links, now: now}) do
    case Snapshot.silent_us(vehicle, links, now) do
      nil -> {:unknown, "It was never heard."}
      us when us < @late_us -> {:ready, "It is heard."}
      us -> {:check, "It was last heard #{div(us, @second)} s ago."}
    end
  end

  defp check(:ground, vehicle, _beside) do
    cond do
      not Snapshot.flies?(vehicle) -> nil
      Snapshot.data(vehicle, :mode)[:in_air] == true -> {:not_ready, "It is in the air."}
      Snapshot.data(vehicle, :mode)[:in_air] == false -> {:ready, "It is on the ground."}
      true -> {:unknown, "Nobody knows whether it is on the ground."}
    end
  end

  defp check(:battery, vehicle, beside) do
    case fresh(vehicle, :battery, beside) do
      %{charge_state: state} when state in ~w(CRITICAL EMERGENCY FAILED UNHEALTHY) ->
        {:not_ready, "The vehicle says that its battery is #{String.downcase(state)}."}

      %{remaining: left} when is_number(left) ->
        charge(left, beside)

      %{voltage: volts} when is_number(volts) ->
        {:unknown, "Only its voltage is known, #{Float.round(volts / 1, 1)} V."}

      _unknown ->
        {:unknown, "The charge is not known."}
    end
  end

  defp check(:gps, vehicle, beside) do
    case fresh(vehicle, :gps, beside) do
      %{fix: fix} when is_integer(fix) and fix < 3 ->
        {:not_ready, "No position with height (fix #{fix})."}

      %{fix: fix, satellites: n} when is_integer(fix) and is_integer(n) and n < @satellites ->
        {:check, "#{n} satellites; #{@satellites} are wanted."}

      %{fix: fix, satellites: n} when is_integer(fix) and is_integer(n) ->
        {:ready, "#{n} satellites."}

      %{fix: fix} when is_integer(fix) ->
        {:unknown, "It does not say how many satellites it sees."}

      _unknown ->
        {:unknown, "No GPS is heard."}
    end
  end

  defp check(:home, vehicle, _beside) do
    case Snapshot.data(vehicle, :home) do
      %{lat: lat, lon: lon} when is_number(lat) and is_number(lon) -> {:ready, "Its home is set."}
      _unknown -> if has?(vehicle, "set_home"), do: {:unknown, "It has not said where its home is."}
    end
  end

  defp check(:arming, vehicle, %{events: events, clock: clock}) do
    failsafe? = Snapshot.data(vehicle, :mode)[:failsafe] == true

    case Arming.of(vehicle, events, clock) do
      _any when failsafe? -> {:not_ready, "It reports a failsafe or an emergency."}
      %{armed: true} -> {:check, "It is armed."}
      %{ready: false, reasons: []} -> {:not_ready, "Its arming checks fail; it does not say which."}
      %{ready: false, reasons: reasons} -> {:not_ready, sentence(reasons)}
      %{ready: true} -> {:ready, "Its arming checks pass."}
      %{reasons: [_ | _] = reasons} -> {:not_ready, sentence(reasons)}
      _unknown -> {:unknown, "It does not tell whether it can be armed."}
    end
  end

  defp check(:mode, vehicle, _beside) do
    mode = Snapshot.data(vehicle, :mode)[:mode]
    first = is_binary(mode) && Firmware.arm_first(vehicle, mode)

    cond do
      not is_binary(mode) -> {:unknown, "Its mode is not known."}
      first -> {:check, "It cannot be armed in #{mode}, but in #{first}."}
      true -> {:ready, "It can be armed in #{mode}."}
    end
  end

  defp check(:fence, vehicle, %{aboard: aboard}) do
    cond do
      Snapshot.data(vehicle, :mission)[:fence_breach] == true -> {:not_ready, "It is outside its fence."}
      true -> aboard(aboard, ["geofence.plan", "geofence.enabled"], "fence")
    end
  end

  defp check(:mission, _vehicle, %{aboard: aboard}), do: aboard(aboard, ["mission.plan"], "mission")

  defp check(:charge, _vehicle, %{holder: nil}), do: {:ready, "Nobody is in charge of it."}

  defp check(:charge, _vehicle, %{holder: name, viewer: :anybody}),
    do: {:ready, "#{name} is in charge of it."}

  defp check(:charge, _vehicle, %{holder: name, viewer: name}), do: {:ready, "You are in charge of it."}
  defp check(:charge, _vehicle, %{holder: name}), do: {:not_ready, "#{name} is in charge of it."}

  # What is reached without MAVLink has no such clock.
  defp check(:boot, %{time_boot_ms: nil} = vehicle, _beside),
    do: if(has?(vehicle, "takeoff"), do: {:unknown, "Nobody knows when it was started."})

  defp check(:boot, %{time_boot_ms: ms}, _beside) when ms < @settled_s * 1000,
    do: {:check, "It was started #{div(ms, 1000)} s ago."}

  defp check(:boot, _vehicle, _beside), do: {:ready, "It has been on for more than #{@settled_s} s."}

  defp charge(left, %{floor: floor}) when is_number(floor) and left < floor,
    do: {:not_ready, "#{percent(left)} left; the policy wants #{percent(floor)} for a take-off."}

  defp charge(left, %{reserve: reserve}) when left < reserve,
    do: {:not_ready, "#{percent(left)} left; #{percent(reserve)} are wanted."}

  defp charge(left, _beside), do: {:ready, "#{percent(left)} left."}

  # Not rounded up: 39.9 % is not 40 %.
  defp percent(share), do: "#{floor(share * 100)} %"

  defp aboard(states, paths, what) do
    open = for path <- paths, state = states[path], state != :converged, do: state

    cond do
      open == [] and Enum.any?(paths, &is_map_key(states, &1)) ->
        {:ready, "The #{what} that is wanted is aboard."}

      open == [] ->
        {:ready, "No particular #{what} is wanted."}

      :unseen in open ->
        {:unknown, "Nobody reports whether the wanted #{what} is aboard."}

      :refused in open ->
        {:not_ready, "The wanted #{what} could not be brought aboard."}

      true ->
        {:not_ready, "The wanted #{what} is not aboard yet."}
    end
  end

  defp fresh(%{groups: groups}, group, %{clock: now}) do
    case groups do
      %{^group => %{at: at, data: data}} when now - at < @old_us -> data
      _old_or_unheard -> %{}
    end
  end

  defp has?(%{autopilot: firmware, vehicle_type: kind}, command),
    do: Firmware.of(firmware).gap(command, kind) == nil

  defp sentence(reasons) do
    more = length(reasons) - @reasons
    listed = reasons |> Enum.take(@reasons) |> Enum.join("; ")
    if more > 0, do: "#{listed}; and #{more} more.", else: "#{listed}."
  end
end
