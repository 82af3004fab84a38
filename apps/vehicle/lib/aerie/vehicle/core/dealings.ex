defmodule Aerie.Vehicle.Core.Dealings do
  @moduledoc """
  What the gateway and a vehicle have to do with each other, apart from its state: streams, clocks, whose heartbeats it
  waits for, ours, and what must not be sent over a link of high latency.
  """

  alias Aerie.Vehicle.{Core, Gcs, Heard, HighLatency, Modes, Params, Reports, State, Timesync}
  alias Aerie.Vehicle.Core.Effects
  alias Aerie.Vehicle.Streams.Arbiter
  alias MavCodec.Messages, as: M

  @ping 4
  @command_ack 77
  @timesync 111
  @message_interval 244
  @available_modes 435
  @heartbeat_us 1_000_000
  @view_us 400_000

  @type acc :: {Core.t(), [Core.action()]}

  @doc """
  A message of the autopilot about such matters: COMMAND_ACK, MESSAGE_INTERVAL, TIMESYNC, PING. The actions come newest
  first.
  """
  @spec message(Core.t(), [Core.action()], term(), struct(), struct()) :: acc()
  # An answer to somebody else is none to us (C7). MAVLink 1 does not say to whom it is.
  def message(core, actions, _link, %{id: @command_ack}, message) do
    if message.target_system in [0, core.options.own_system] and
         message.target_component in [0, core.options.own_component],
       do: {%{core | streams: Arbiter.ack(core.streams, message.command, message.result)}, actions},
       else: {core, actions}
  end

  def message(core, actions, _link, %{id: @message_interval, at: at}, message) do
    {%{core | streams: Arbiter.interval(core.streams, message.message_id, message.interval_us, at)}, actions}
  end

  def message(core, actions, link, %{id: @timesync, at: at}, %{tc1: tc1} = answer) when tc1 != 0 do
    if Timesync.to?(answer, own(core)), do: round_trip(core, actions, link, answer, at), else: {core, actions}
  end

  # A PING to us is the answer to one of ours (X5).
  def message(
        %{options: %{own_system: system, own_component: component}} = core,
        actions,
        link,
        %{id: @ping, at: at},
        %{target_system: system, target_component: component} = answer
      ),
      do: round_trip(core, actions, link, answer, at)

  def message(core, actions, link, frame, request) do
    from = {frame.system, frame.component}

    with answer when answer != nil <- Timesync.answer(request, from, own(core), frame.at),
         false <- HighLatency.high?(core.high_latency, link),
         {true, timesync} <- Timesync.answer?(core.timesync, frame.at) do
      {%{core | timesync: timesync}, [{:send, answer, core.version} | actions]}
    else
      _none -> {core, actions}
    end
  end

  defp round_trip(core, actions, link, answer, at) do
    case Timesync.reply(core.timesync, answer, at, link) do
      {timesync, nil} -> {%{core | timesync: timesync}, actions}
      {timesync, {link, us}} -> {%{core | timesync: timesync}, [{:round_trip, link, us} | actions]}
    end
  end

  defp own(core), do: {core.options.own_system, core.options.own_component}

  @doc "A parameter's value came."
  @spec param(Core.t(), Params.value()) :: Core.t()
  def param(core, {name, value, _index}), do: %{core | gcs: Gcs.param(core.gcs, name, value)}

  @doc "A frame came by a link, of which only its id matters."
  @spec heard(Core.t(), term(), non_neg_integer(), integer()) :: Core.t()
  def heard(core, link, id, at), do: %{core | streams: Arbiter.heard(core.streams, link, id, at)}

  @doc "The autopilot's heartbeat came by a link."
  @spec beat_heard(Core.t(), term(), integer()) :: Core.t()
  def beat_heard(core, link, at), do: %{core | high_latency: HighLatency.beat(core.high_latency, link, at)}

  @doc "HIGH_LATENCY2 came by a link."
  @spec summary_heard(Core.t(), term(), integer()) :: Core.t()
  def summary_heard(core, link, at),
    do: %{core | high_latency: HighLatency.summary(core.high_latency, link, at)}

  @doc "The vehicle was restarted."
  @spec rebooted(Core.t(), integer()) :: Core.t()
  def rebooted(core, at) do
    %{
      core
      | streams: Arbiter.rebooted(core.streams, at),
        timesync: Timesync.restarted(core.timesync),
        gcs: Gcs.rebooted(core.gcs, at)
    }
  end

  @doc "Time goes on from `now`, whatever it was before."
  @spec rebased(Core.t(), integer()) :: Core.t()
  def rebased(core, now) do
    %{
      core
      | heartbeat: nil,
        streams: Arbiter.rebased(core.streams, now),
        timesync: Timesync.restarted(core.timesync),
        gcs: Gcs.rebased(core.gcs, now),
        reports: Reports.rebased(core.reports, now),
        high_latency: HighLatency.rebased(core.high_latency, now)
    }
  end

  @doc "The clock was set by `step`: `core` is as it was, `rebased` as `rebased/2` left it."
  @spec shifted(Core.t(), Core.t(), integer()) :: Core.t()
  def shifted(core, rebased, step) do
    %{
      rebased
      | timesync: Timesync.shifted(core.timesync, step),
        gcs: Gcs.shifted(core.gcs, step),
        high_latency: HighLatency.shifted(core.high_latency, step)
    }
  end

  @doc "Silence after which the vehicle is stale, and lost (us)."
  @spec patience(Core.t(), integer()) :: {stale_us :: pos_integer(), lost_us :: pos_integer()}
  def patience(%{options: options} = core, now) do
    lost_us = max(options.lost_us, options.lost_high_latency_us)
    last = HighLatency.last(core.high_latency)

    if last != nil and now - last <= lost_us and only_high?(core, now) do
      {lost_us, lost_us}
    else
      {options.stale_us, options.lost_us}
    end
  end

  @doc "Whether the vehicle can be reached by links of high latency only."
  @spec only_high?(Core.t(), integer()) :: boolean()
  def only_high?(core, now),
    do: HighLatency.only?(core.high_latency, Heard.times(core.heard), now, core.options.lost_us)

  @doc "Whether it can be asked for something: not by links of high latency only."
  @spec open?(Core.t(), integer()) :: boolean()
  def open?(core, now), do: way(core) != :none and not only_high?(core, now)

  @doc "By which link to send what is not for links of high latency (`Aerie.Vehicle.HighLatency.way/2`)."
  @spec way(Core.t()) :: :any | {:link, term()} | :none
  def way(core), do: HighLatency.way(core.high_latency, Heard.times(core.heard))

  @doc "What is due at `now`."
  @spec expire(acc(), integer()) :: acc()
  def expire({%{component: nil} = core, actions}, _now), do: {core, actions}

  def expire({core, actions}, now) do
    # Nothing of this is for a link of high latency (X6), and only who is heard is asked for anything.
    open = way(core) != :none
    ask = core.status == :online and open?(core, now)
    {core, actions} |> streams(now, ask) |> clock(now, ask) |> gcs(now, ask) |> beat(now, open)
  end

  defp streams({%{options: %{request_streams: true}} = core, actions}, now, true) do
    core = named(core)
    {streams, messages, notices} = Arbiter.expire(core.streams, now, target(core))
    # Another vehicle's streams come at rates of their own.
    told =
      if notices == [] or Effects.doubtful?(core, now),
        do: [],
        else: [{:observe, {:streams, now, core.state.boot_ms, notices}}]

    tell({%{core | streams: streams}, sent(core, messages) ++ actions}, told, now)
  end

  defp streams(acc, _now, _ask), do: acc

  # It is in a mode whose name only it knows.
  defp named(%{state: %{autopilot: :generic}} = core), do: core

  defp named(core) do
    if Modes.unnamed?(State.data(core.state, :mode).mode),
      do: %{core | streams: Arbiter.once(core.streams, @available_modes)},
      else: core
  end

  defp clock({core, actions}, now, true) do
    {timesync, requests} = Timesync.expire(core.timesync, now, asked(core, now))

    actions =
      Enum.reduce(requests, actions, fn
        {nil, message}, actions -> [{:send, addressed(message, core), core.version} | actions]
        {link, message}, actions -> [{:send, addressed(message, core), core.version, link} | actions]
      end)

    {%{core | timesync: timesync}, actions}
  end

  defp clock(acc, _now, _ask), do: acc

  # To nobody in particular it would be answered by every vehicle on a radio's network. (A PING to somebody is an answer.)
  defp addressed(%M.Timesync{} = request, core) do
    {system, component} = target(core)
    %{request | target_system: system, target_component: component}
  end

  defp addressed(request, _core), do: request

  # The links that it can be asked by: it was heard there just now, and a byte costs nothing (X6).
  defp asked(core, now) do
    for {link, at} <- Heard.times(core.heard),
        at != nil and now - at < core.options.lost_us,
        not HighLatency.high?(core.high_latency, link),
        do: link
  end

  defp gcs({core, actions}, now, ask) do
    known = Gcs.vehicle(core.gcs, core.state.autopilot, core.state.kind)
    {gcs, messages, notices} = Gcs.expire(known, now, target(core), ask and core.options.read_gcs_parameters)
    told = for {what, at, facts} <- notices, do: {:observe, {:gcs, at, core.state.boot_ms, what, facts}}
    tell({%{core | gcs: gcs}, sent(core, messages) ++ actions}, told, now)
  end

  # Shown before it is told: who hears of it looks.
  defp tell(acc, [], _now), do: acc

  defp tell({core, actions}, told, now) do
    {core, actions} = Effects.show({%{core | dirty: true, shown: nil}, actions}, now)
    {core, Enum.reverse(told) ++ actions}
  end

  # Fed by this loop: no heartbeat from a gateway whose loops stand still (H3). A vehicle that is lost gets it too, its
  # own receiver may be all that works. One that speaks MAVLink 1 is shown every other time that we speak 2, which is
  # how ArduPilot comes to (V2).
  defp beat({%{options: %{heartbeat: true}} = core, actions}, now, true) do
    cond do
      core.heartbeat != nil and now - core.heartbeat < @heartbeat_us ->
        {core, actions}

      mistaken?(core) ->
        {%{core | heartbeat: now}, [:withhold | actions]}

      true ->
        version = if core.version == 1, do: 3 - core.beat, else: 2
        {%{core | heartbeat: now, beat: version}, [{:heartbeat, version} | actions]}
    end
  end

  defp beat(acc, _now, _open), do: acc

  @doc """
  Whether the vehicle would take our heartbeat for its operator's, though we are not: its failsafe listens to our id (H5).
  """
  @spec mistaken?(Core.t()) :: boolean()
  def mistaken?(%{options: %{i_am_the_gcs: true}}), do: false
  def mistaken?(core), do: ours?(core)

  @doc "Whether our heartbeat keeps, or would keep, the vehicle's failsafe quiet."
  @spec ours?(Core.t()) :: boolean()
  def ours?(%{options: options, gcs: gcs}) do
    type = if options.heartbeat_type == :gcs, do: 6, else: 18
    Gcs.keeps?(gcs, %{system: options.own_system, type: type})
  end

  @doc """
  Renews `view`, what snapshots show of all this, at most a few times a second: it changes seldom and is as much as the
  rest of a snapshot. At once when something was told or the vehicle's status changed (`shown: nil`).
  """
  @spec view(Core.t(), integer()) :: Core.t()
  def view(%{view: view, viewed: at, shown: shown} = core, now)
      when view != nil and shown != nil and now >= at and now - at < @view_us,
      do: core

  def view(core, now), do: %{core | view: show(core), viewed: now}

  @doc "What the snapshot shows of all this, as of now."
  @spec show(Core.t()) :: map()
  def show(%{now: now} = core) do
    now = now || 0

    %{
      streams: if(core.options.request_streams, do: Arbiter.show(core.streams), else: %{}),
      clock: Timesync.show(core.timesync, now),
      gcs: Map.merge(Gcs.show(core.gcs, now), %{by_us?: ours?(core), withheld?: mistaken?(core)}),
      reports: Reports.show(core.reports),
      high_latency: %{only?: only_high?(core, now), links: HighLatency.links(core.high_latency)}
    }
  end

  defp target(core), do: {core.options.system_id, core.component}

  defp sent(core, messages), do: messages |> Enum.map(&{:send, &1, core.version}) |> Enum.reverse()
end
