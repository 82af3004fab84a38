defmodule Aerie.Vehicle.Session.Core.Services do
  @moduledoc """
  Exchanges between the gateway and a vehicle that are not its state: stream rates, clocks, which ground station its
  failsafe listens to, our heartbeat, and what must not be sent by a high-latency link.
  """

  alias Aerie.Vehicle.Session.ArmAuthorization
  alias Aerie.Vehicle.Firmware.Modes
  alias Aerie.Vehicle.State
  alias Aerie.Vehicle.Session.Core
  alias Aerie.Vehicle.Services.{Gcs, Params, Reports, Switches, Timesync}
  alias Aerie.Vehicle.Session.Core.{Collisions, Effects, SnapshotSchedule}
  alias Aerie.Vehicle.Services.Links.{HighLatency, Reception}
  alias Aerie.Vehicle.Services.Streams.Arbiter
  alias MavCodec.Messages, as: M
  alias MavRouter.Identity.Heartbeat

  @available_modes M.AvailableModes.id()
  @heartbeat_us Heartbeat.every_ms() * 1_000

  @type acc :: {Core.t(), [Core.action()]}

  @doc """
  COMMAND_ACK, COMMAND_LONG, MESSAGE_INTERVAL, TIMESYNC or PING of the autopilot. Actions are newest first.
  """
  @spec message(Core.t(), [Core.action()], term(), struct(), struct()) :: acc()
  # Answers to others are not for us (C7). In MAVLink 1 the target is not given.
  def message(core, actions, _link, _frame, %M.CommandAck{} = message) do
    if message.target_system in [0, core.options.own_system] and
         message.target_component in [0, core.options.own_component],
       do: {%{core | streams: Arbiter.ack(core.streams, message.command, message.result)}, actions},
       else: {core, actions}
  end

  # A vehicle that asks us before it arms (X13).
  def message(core, actions, _link, frame, %M.CommandLong{} = asked) do
    {system, component} = own(core)

    if asked.command == ArmAuthorization.request() and asked.target_system == system and
         asked.target_component in [0, component],
       do: {core, [{:authorise_arming, {frame.system, frame.component}} | actions]},
       else: {core, actions}
  end

  def message(core, actions, _link, %{at: at}, %M.MessageInterval{} = message) do
    {%{core | streams: Arbiter.interval(core.streams, message.message_id, message.interval_us, at)}, actions}
  end

  def message(core, actions, link, %{at: at}, %M.Timesync{tc1: tc1} = answer) when tc1 != 0 do
    if Timesync.to?(answer, own(core)), do: round_trip(core, actions, link, answer, at), else: {core, actions}
  end

  # A PING to us answers one of ours (X5).
  def message(
        %{options: %{own_system: system, own_component: component}} = core,
        actions,
        link,
        %{at: at},
        %M.Ping{target_system: system, target_component: component} = answer
      ),
      do: round_trip(core, actions, link, answer, at)

  def message(core, actions, link, frame, request) do
    from = {frame.system, frame.component}

    with answer when answer != nil <- Timesync.answer(request, from, own(core), frame.at),
         false <- HighLatency.high_latency?(core.high_latency, link),
         {true, timesync} <- Timesync.answer?(core.timesync, frame.at) do
      {%{core | timesync: timesync}, [{:send, answered(answer, core), core.version} | actions]}
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

  @doc "Whether requests are held, and no answer to an earlier one is awaited any more."
  @spec requests_held?(Core.t()) :: boolean()
  def requests_held?(core), do: Arbiter.held?(core.streams, core.now)

  @doc "A parameter has this value."
  @spec param(Core.t(), Params.value()) :: Core.t()
  def param(core, {name, value, _index}) do
    %{core | gcs: Gcs.param(core.gcs, name, value), switches: Switches.param(core.switches, name, value)}
  end

  @doc "A message of the autopilot came by a link."
  @spec received(Core.t(), term(), non_neg_integer(), integer()) :: Core.t()
  def received(core, link, id, at), do: %{core | streams: Arbiter.received(core.streams, link, id, at)}

  @doc "The autopilot's heartbeat came by a link."
  @spec heartbeat_heard(Core.t(), term(), integer()) :: Core.t()
  def heartbeat_heard(core, link, at),
    do: %{core | high_latency: HighLatency.heartbeat(core.high_latency, link, at)}

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
        modes_asked: nil,
        reports: Reports.rebooted(core.reports),
        timesync: Timesync.restarted(core.timesync),
        gcs: Gcs.rebooted(core.gcs, at),
        switches: Switches.rebooted(core.switches, at)
    }
  end

  @doc "Time goes on from `now`, which is not comparable with the time before."
  @spec rebased(Core.t(), integer()) :: Core.t()
  def rebased(core, now) do
    %{
      core
      | heartbeat: %{core.heartbeat | at: nil},
        streams: Arbiter.rebased(core.streams, now),
        timesync: Timesync.restarted(core.timesync),
        gcs: Gcs.rebased(core.gcs, now),
        switches: Switches.rebased(core.switches, now),
        reports: Reports.rebased(core.reports, now),
        high_latency: HighLatency.rebased(core.high_latency, now)
    }
  end

  @doc "The clock was set by `step`; `core` is as before, `rebased` is the result of `rebased/2`."
  @spec shifted(Core.t(), Core.t(), integer()) :: Core.t()
  def shifted(core, rebased, step) do
    %{
      rebased
      | timesync: Timesync.shifted(core.timesync, step),
        gcs: Gcs.shifted(core.gcs, step),
        switches: Switches.shifted(core.switches, step),
        high_latency: HighLatency.shifted(core.high_latency, step)
    }
  end

  @doc "How long the vehicle may be silent before it is stale, and before it is lost (us)."
  @spec timeouts(Core.t(), integer()) :: {stale_us :: pos_integer(), lost_us :: pos_integer()}
  def timeouts(%{options: options} = core, now) do
    lost_us = max(options.lost_us, options.lost_high_latency_us)
    last = HighLatency.last(core.high_latency)

    if last != nil and now - last <= lost_us and only_high_latency?(core, now) do
      {lost_us, lost_us}
    else
      {options.stale_us, options.lost_us}
    end
  end

  @doc "After which silence of a link the vehicle is lost on it (us)."
  @spec lost_us(Core.t(), term()) :: pos_integer()
  def lost_us(%{options: options} = core, link) do
    if HighLatency.high_latency?(core.high_latency, link),
      do: max(options.lost_us, options.lost_high_latency_us),
      else: options.lost_us
  end

  @doc "Whether the vehicle can only be reached by high-latency links."
  @spec only_high_latency?(Core.t(), integer()) :: boolean()
  def only_high_latency?(core, now) do
    times = Reception.times(core.reception)
    HighLatency.only?(core.high_latency, times, now, core.options.lost_us)
  end

  @doc "Whether the vehicle may be sent requests: not while only high-latency links reach it."
  @spec requests?(Core.t(), integer()) :: boolean()
  def requests?(core, now), do: link(core) != :none and not only_high_latency?(core, now)

  @doc "By which link to send what is not for high-latency links (`Aerie.Vehicle.Services.Links.HighLatency.other_link/2`)."
  @spec link(Core.t()) :: :any | {:link, term()} | :none
  def link(core), do: HighLatency.other_link(core.high_latency, Reception.times(core.reception))

  @doc "Does what is due at `now`."
  @spec expire(acc(), integer()) :: acc()
  def expire({%{component: nil} = core, actions}, _now), do: {core, actions}

  def expire({core, actions}, now) do
    # None of this is for a high-latency link (X6), and requests only go to a vehicle that is heard.
    reachable = link(core) != :none
    ask = reachable and core.status == :online and not only_high_latency?(core, now)

    {core, actions}
    |> streams(now, ask)
    |> clock(now, ask)
    |> gcs(now, ask)
    |> switches(now, ask)
    |> heartbeat(now, reachable)
  end

  defp streams({%{options: %{request_streams: true}} = core, actions}, now, true) do
    core = ask_for_mode_names(core)
    {streams, messages, notices} = Arbiter.expire(core.streams, now, target(core))
    # Another vehicle with the same id has stream rates of its own.
    observed =
      if notices == [] or Collisions.suspected?(core, now),
        do: [],
        else: [Effects.observation(core, :streams, now, notices)]

    observe({%{core | streams: streams}, sent(core, messages) ++ actions}, observed, now)
  end

  defp streams(acc, _now, _ask), do: acc

  # Only the vehicle knows the name of its mode; by MSP it tells unasked.
  defp ask_for_mode_names(%{state: %{autopilot: firmware, modes_seq: seq} = state} = core) do
    cond do
      not Modes.known?(firmware) ->
        core

      # The standard modes, and again when the vehicle tells that its modes have changed (X4).
      seq not in [nil, core.modes_asked] ->
        %{core | modes_asked: seq, streams: Arbiter.again(core.streams, @available_modes)}

      Modes.unnamed?(State.data(state, :mode).mode) ->
        %{core | streams: Arbiter.once(core.streams, @available_modes)}

      true ->
        core
    end
  end

  # On most ticks no request is due, so the links to ask need not be worked out.
  defp clock({%{timesync: %{next: next}}, _actions} = acc, now, true) when next != nil and now < next, do: acc

  defp clock({core, actions}, now, true) do
    {timesync, requests} = Timesync.expire(core.timesync, now, asked_links(core, now))

    actions =
      Enum.reduce(requests, actions, fn
        {nil, message}, actions -> [{:send, addressed(message, core), core.version} | actions]
        {link, message}, actions -> [{:send, addressed(message, core), core.version, link} | actions]
      end)

    {%{core | timesync: timesync}, actions}
  end

  defp clock(acc, _now, _ask), do: acc

  # Without a target, every vehicle on a radio's network would answer, as it has to in MAVLink 1. (A PING with a target
  # is an answer.)
  defp addressed(%M.Timesync{} = request, %{version: 2} = core) do
    {system, component} = target(core)
    %{request | target_system: system, target_component: component}
  end

  defp addressed(request, _core), do: request

  # MAVLink 1 tells the receiver by the time that is given back.
  defp answered(%M.Timesync{} = answer, %{version: 1}), do: %{answer | target_system: 0, target_component: 0}
  defp answered(answer, _core), do: answer

  # The links that are measured: the vehicle is heard on them, and a byte costs nothing (X6).
  defp asked_links(core, now) do
    for {link, at} <- Reception.times(core.reception),
        at != nil and now - at < core.options.lost_us,
        not HighLatency.high_latency?(core.high_latency, link),
        do: link
  end

  defp gcs({core, actions}, now, ask) do
    known = Gcs.vehicle(core.gcs, core.state.autopilot, core.state.kind)
    {gcs, messages, notices} = Gcs.expire(known, now, target(core), ask and core.options.read_gcs_parameters)
    observed = for {what, at, facts} <- notices, do: Effects.observation(core, :gcs, at, {what, facts})
    observe({%{core | gcs: gcs}, sent(core, messages) ++ actions}, observed, now)
  end

  defp switches({%{options: %{read_gcs_parameters: true}} = core, actions}, now, true) do
    firmware = {core.state.autopilot, core.state.kind}
    {switches, messages} = Switches.due(core.switches, now, target(core), firmware)
    {%{core | switches: switches}, sent(core, messages) ++ actions}
  end

  defp switches(acc, _now, _ask), do: acc

  # The snapshot comes first: readers of the event look at it.
  defp observe(acc, [], _now), do: acc

  defp observe({core, actions}, observed, now) do
    {core, actions} =
      Effects.show({%{core | dirty: true, shown: SnapshotSchedule.due(core.shown)}, actions}, now)

    {core, Enum.reverse(observed) ++ actions}
  end

  # Driven by this loop, so a gateway whose loops hang sends none (H3). A lost vehicle gets it too: its receiver may be all
  # that works. To a vehicle that speaks MAVLink 1 every other heartbeat is in version 2, which makes ArduPilot switch (V2).
  defp heartbeat({%{options: %{heartbeat: true}} = core, actions}, now, true) do
    cond do
      core.heartbeat.at != nil and now - core.heartbeat.at < @heartbeat_us ->
        {core, actions}

      mistaken?(core) ->
        {put_in(core.heartbeat.at, now), [:withhold | actions]}

      true ->
        version = if core.version == 1, do: 3 - core.heartbeat.version, else: 2

        {%{core | heartbeat: %{core.heartbeat | at: now, version: version}},
         [{:heartbeat, version} | actions]}
    end
  end

  defp heartbeat(acc, _now, _reachable), do: acc

  @doc """
  Whether the vehicle would take our heartbeat for its operator's although we are not a ground station: its failsafe listens
  to our id (H5).
  """
  @spec mistaken?(Core.t()) :: boolean()
  def mistaken?(%{options: %{i_am_the_gcs: true}}), do: false
  def mistaken?(core), do: ours?(core)

  @doc "Whether our heartbeat keeps, or would keep, the vehicle's failsafe quiet."
  @spec ours?(Core.t()) :: boolean()
  def ours?(%{options: options, gcs: gcs}) do
    Gcs.keeps_quiet?(gcs, %{system: options.own_system, type: Heartbeat.type(options.heartbeat_type)})
  end

  @doc "The data of these services for a snapshot."
  @spec show(Core.t()) :: map()
  def show(%{now: now} = core) do
    now = now || 0

    %{
      streams: if(core.options.request_streams, do: Arbiter.show(core.streams), else: %{}),
      clock: Timesync.show(core.timesync, now),
      gcs: Map.merge(Gcs.show(core.gcs, now), %{by_us?: ours?(core), withheld?: mistaken?(core)}),
      params: core.switches.params,
      reports: Reports.show(core.reports),
      high_latency: %{only?: only_high_latency?(core, now), links: HighLatency.links(core.high_latency)}
    }
  end

  defp target(core), do: {core.options.system_id, core.component}

  defp sent(_core, []), do: []
  defp sent(core, messages), do: messages |> Enum.map(&{:send, &1, core.version}) |> Enum.reverse()
end
