defmodule Msp.Session.Reports do
  @moduledoc """
  What follows from the reply to a poll: readings, the vehicle's clock, MAVLink messages, and a text when something else keeps the
  vehicle from being armed.
  """

  alias Msp.{Firmware, Identity, Modes, Polls, Readings, Session}
  alias Msp.Firmware.Arming
  alias Msp.Readings.Status
  alias Msp.Session.{Clients, Missions, Output, Requests, Sticks}

  defstruct [:heartbeat, :introduced_at, :complaint, :height]

  @typedoc """
  - `heartbeat`: the last one, and when it was sent; `introduced_at`: when it was last said which firmware it is
  - `complaint`: the names of the last text about what keeps it from being armed
  - `height`: the last one of an armed vehicle, and when it was read, until it says that it is still armed
  """
  @type t :: %__MODULE__{}

  @heartbeat_us 1_000_000
  @introduce_us 10_000_000
  # iNav's clock has seconds.
  @clock_us 2_000_000
  # Until a receiver that is missed shows.
  @grace_us 1_500_000
  # m/s, m
  @still 0.5
  @fastest 100
  @near 10
  # The mode of NAV_STATUS.
  @emergency 15
  @critical 2
  @warning 4
  @info 6

  @doc "The reply to a poll, decoded."
  @spec polled(Session.t(), name :: String.t(), values :: map, integer) :: Session.t()
  def polled(session, "BOXIDS", values, _now), do: %{session | ids: ids(values)}

  def polled(session, name, values, now) do
    readings = session.identity.firmware |> Readings.read(name, values, session.ids) |> dated(now)
    if readings == %{}, do: session, else: read(session, name, readings, now)
  end

  defp read(session, "ALTITUDE", %{alt_rel: up} = height, now) do
    cond do
      # Its heights are above its origin, and home is where it was armed, or set.
      home_told?(session) ->
        session = read_all(session, %{alt_local: up})
        height(session, %{height | alt_rel: above_home(session, up)}, now, now)

      # Where it was armed is its home. Until then its heights are above the sea or above anything, and again from when
      # it is disarmed: so one counts if it was armed before and after.
      not armed?(session) ->
        session |> read_all(%{height | alt_rel: nil}) |> show("ALTITUDE", now)

      Sticks.steered?(session) ->
        session = put_in(session.reports.height, {height, now})
        %{session | polls: Polls.soon(session.polls, Polls.status_names(), now)}

      true ->
        put_in(session.reports.height, {height, now})
    end
  end

  defp read(session, name, readings, now) do
    before = session.readings
    was_armed? = armed?(session)

    session
    |> clock(readings, now)
    |> read_all(readings)
    |> origin(readings, now)
    |> mission(readings)
    |> show(name, now)
    |> failsafe(before)
    |> navigation(before)
    |> confirm(readings, was_armed?, now)
  end

  defp read_all(session, readings), do: %{session | readings: Map.merge(session.readings, readings)}
  defp armed?(%{readings: %{boxes: boxes}}), do: Modes.armed?(boxes)
  defp armed?(_unknown), do: false
  defp home_told?(session), do: Firmware.of(session.identity.firmware).home_told?

  defp above_home(%{readings: %{home: {_lat, _lon, home}, origin_msl: origin}}, up) when origin != nil,
    do: up - (home - origin)

  defp above_home(%{readings: %{home: nil}}, up), do: up
  # Its build has none.
  defp above_home(%{polls: polls}, up), do: if(not Polls.asks?(polls, "WP"), do: up)

  # Only while it hardly moves were both heights of the same moment.
  defp origin(%{readings: %{alt_local: up} = known} = session, %{here_msl: here}, now) do
    still? = not armed?(session) or not is_map_key(known, :origin_msl) or abs(known[:climb] || 0) < @still
    origin = if here, do: if(still?, do: here - up, else: known.origin_msl)
    session |> read_all(%{origin_msl: origin}) |> places(now)
  end

  defp origin(session, %{home: _home}, now), do: places(session, now)
  defp origin(session, _readings, _now), do: session

  defp places(%{readings: %{home: _, origin_msl: _}} = session, _now), do: session
  defp places(session, now), do: %{session | polls: Polls.soon(session.polls, ["WP"], now)}

  defp confirm(session, %{boxes: _known}, was_armed?, now) do
    cond do
      not home_told?(session) -> confirm_height(session, was_armed?, now)
      armed?(session) == was_armed? -> session
      # Where it is armed is home, and its origin may have moved until then.
      true -> places(%{session | readings: Map.drop(session.readings, [:home, :origin_msl, :alt_rel])}, now)
    end
  end

  defp confirm(session, _readings, _was_armed?, _now), do: session

  defp confirm_height(session, was_armed?, now) do
    last = put_in(session.reports.height, nil)

    case {session.reports.height, armed?(session)} do
      {_any, false} ->
        read_all(last, %{alt_rel: nil, alt_last: nil})

      {_any, true} when not was_armed? ->
        read_all(last, %{alt_last: {0.0, now}})

      {nil, true} ->
        last

      {{height, at}, true} ->
        if(far?(session.readings, height, at), do: last, else: height(last, height, at, now))
    end
  end

  # Nothing gets so far in the time: it was disarmed meanwhile, or its filter still comes down from the height above the
  # sea.
  defp far?(%{alt_last: {before, then}}, %{alt_rel: height}, at),
    do: abs(height - before) > @near + @fastest * (at - then) / 1_000_000

  defp far?(_first, _height, _at), do: false

  defp height(session, height, at, now) do
    known? = Readings.altimeter?(session.readings)
    dated = Map.merge(height, %{alt_at: at, alt_last: {height.alt_rel, at}})
    height = if known?, do: dated, else: %{alt_rel: nil, climb: nil}
    session |> read_all(height) |> show("ALTITUDE", now)
  end

  # Flags whose meaning is not known say nothing.
  defp dated(%{boxes: nil}, _now), do: %{}
  defp dated(%{boxes: _known} = readings, now), do: Map.put(readings, :boxes_at, now)
  defp dated(readings, _now), do: readings

  defp mission(session, %{waypoints: count}), do: Missions.counted(session, count)
  defp mission(session, _readings), do: session

  @doc "The ids of BOXIDS."
  @spec ids(map | nil) :: [byte]
  def ids(%{entries: entries}), do: Enum.map(entries, & &1.id)
  def ids(_none), do: []

  # iNav says for how long it has been running. Betaflight does not arm in its first seconds: if that comes again, it was restarted.
  defp clock(session, %{on_s: on_s}, now) when is_integer(on_s) do
    boot = now - on_s * 1_000_000
    if abs(boot - session.boot) > @clock_us, do: %{session | boot: boot}, else: session
  end

  defp clock(%{readings: %{arming: before}} = session, %{arming: flags}, now)
       when is_integer(flags) and is_integer(before) do
    target = Identity.target(session.identity)
    restarted? = Arming.booting?(target, flags) and not Arming.booting?(target, before)
    grace(if(restarted?, do: %{session | boot: now}, else: session), flags, now)
  end

  defp clock(session, %{arming: flags}, now) when is_integer(flags), do: grace(session, flags, now)

  defp clock(session, _readings, _now), do: session

  # It looks for its receiver only when it may be armed.
  defp grace(session, flags, now) do
    if Arming.booting?(Identity.target(session.identity), flags),
      do: Sticks.unsure(session, now + @grace_us),
      else: session
  end

  defp show(session, name, now) when name in ["STATUS_EX", "MSP2_INAV_STATUS"] do
    heartbeat = Status.heartbeat(session.identity, session.type, session.readings)

    case session.reports.heartbeat do
      {^heartbeat, at} when now - at < @heartbeat_us -> session
      nil -> session |> Output.emit(heartbeat) |> identify(now) |> introduce() |> status(heartbeat, now)
      _changed_or_due -> session |> Output.emit(heartbeat) |> identify(now) |> status(heartbeat, now)
    end
    |> complain()
  end

  defp show(session, name, now) do
    context = %{
      boot_us: now - session.boot,
      boot_ms: Output.boot_ms(session, now),
      aboard: session.missions.aboard
    }

    name |> Readings.messages(session.readings, context) |> Enum.reduce(session, &tell(&2, &1, now))
  end

  # At the rate that clients want: others may be made of the same reply.
  defp tell(session, %module{} = message, now) do
    {due?, polls} = Polls.tell(session.polls, module.id(), now)
    session = %{session | polls: polls}
    if due?, do: Output.emit(session, message), else: session
  end

  # After the first heartbeat: who it is, and what its modes are called.
  defp introduce(session) do
    session
    |> Output.emit([Requests.version(session) | Requests.modes(session)])
    |> Output.text(@info, session.identity.text)
  end

  # Again now and then, for those who were not there: a heartbeat cannot say which firmware it is.
  defp identify(%{reports: %{introduced_at: at}} = session, now) when at != nil and now - at < @introduce_us,
    do: session

  defp identify(session, now),
    do: put_in(session.reports.introduced_at, now) |> Output.emit(Requests.identity(session))

  defp status(session, heartbeat, now) do
    put_in(session.reports.heartbeat, {heartbeat, now})
    |> Output.emit(Status.sys_status(session.identity, session.readings))
  end

  # A heartbeat shows that there is one, a text why and what the vehicle does.
  defp failsafe(%{readings: %{boxes: boxes}} = session, %{boxes: before}) do
    case {Modes.failsafe?(before), Modes.failsafe?(boxes)} do
      {false, true} -> Output.text(session, @critical, failsafe_text(session))
      {true, false} -> Output.text(session, @info, "Failsafe cleared")
      _same -> session
    end
  end

  defp failsafe(session, _before), do: session

  defp failsafe_text(%{readings: readings} = session) do
    %{firmware: firmware} = session.identity
    armed? = Modes.armed?(readings.boxes)
    lost? = Arming.rc_lost?(Identity.target(session.identity), readings[:arming] || 0, armed?)
    does = if armed?, do: Modes.failsafe_action(firmware, readings.boxes), else: "disarmed"
    "#{if lost?, do: "RC failsafe", else: "Failsafe"}: switched to #{does}"
  end

  # What no mode shows: it comes down because it has lost its position.
  defp navigation(%{readings: %{nav_mode: @emergency}} = session, before) do
    if before[:nav_mode] == @emergency,
      do: session,
      else: Output.text(session, @critical, "Emergency landing: no position")
  end

  defp navigation(session, _before), do: session

  # Once for each change, while it is disarmed.
  defp complain(%{readings: %{arming: flags, boxes: boxes}} = session) when is_integer(flags) do
    names = if Modes.armed?(boxes), do: [], else: Arming.names(Identity.target(session.identity), flags)
    before = session.reports.complaint

    cond do
      names == before ->
        session

      names == [] ->
        put_in(session.reports.complaint, [])

      true ->
        put_in(session.reports.complaint, names)
        |> Output.text(@warning, "Arming disabled: " <> Enum.join(names, ", "))
        |> Clients.disabled("MSP" in (names -- (before || [])))
    end
  end

  defp complain(session), do: session
end
