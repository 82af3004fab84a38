defmodule Aerie.Vehicle.Session.Core.Frames do
  @moduledoc """
  One frame of the vehicle's system: which component sent it, whether it is worth decoding, and which part of the core
  handles it. Actions are newest first.
  """

  alias MavCodec.Meaning.Heartbeat
  alias MavCodec.Message.BootClock
  alias Aerie.Vehicle.{Collision, State}
  alias Aerie.Vehicle.Session.Core
  alias Aerie.Vehicle.Services.Params
  alias Aerie.Vehicle.Session.Core.{Collisions, Effects, Reporting, Services, Texts}
  alias Aerie.Vehicle.Events.Detector.Observation
  alias Aerie.Vehicle.Services.Links.Reception
  alias Aerie.Vehicle.Services.Streams.Arbiter
  alias MavCodec.Messages, as: M

  @heartbeat M.Heartbeat.id()
  @system_time M.SystemTime.id()
  @param_value M.ParamValue.id()
  @high_latency M.HighLatency2.id()
  @statustext M.Statustext.id()
  # By these a component says that it manages the gimbals.
  @gimbal_manager [M.GimbalManagerInformation.id(), M.GimbalManagerStatus.id()]
  # Besides the heartbeat.
  @identifying [@high_latency, M.ComponentInformationBasic.id()]
  @reports [M.Event.id(), M.CurrentEventSequence.id(), M.ResponseEventError.id()]
  # For `Services.message/5`.
  @services [M.Ping.id(), M.CommandAck.id(), M.CommandLong.id(), M.Timesync.id(), M.MessageInterval.id()]
  @decoded [@system_time, @param_value, @statustext | @services]
  # A vehicle that was heard in version 2 for so long is spoken to in it.
  @version2_us 30_000_000
  # A vehicle that restarts is silent for longer than this.
  @silence_us 2_000_000

  @spec frame(Core.t(), [Core.action()], term(), struct()) :: {Core.t(), [Core.action()]}
  def frame(core, actions, link, frame) do
    # Whichever component sent it: the link reaches this system.
    reception = Reception.frame(core.reception, link, byte_size(frame.bytes), frame.at)
    core = gimbal_manager(%{core | reception: reception}, frame)

    cond do
      frame.id == @heartbeat ->
        heartbeat(core, actions, link, frame)

      frame.component == core.component ->
        autopilot(core, actions, link, frame)

      core.component == nil and frame.id == @statustext ->
        {%{core | texts: Texts.hold(core.texts, link, frame)}, actions}

      core.component == nil and frame.id == @high_latency ->
        autopilot(%{core | component: frame.component}, actions, link, frame)

      # Other components of the vehicle send texts and reports as well.
      frame.id == @statustext ->
        decoded(core, actions, link, frame)

      core.component != nil and frame.id in @reports ->
        report(core, actions, frame)

      true ->
        {core, actions}
    end
  end

  # The autopilot's own word counts more than that of a part.
  defp gimbal_manager(%{state: %{gimbal_manager: known}} = core, %{id: id, component: component})
       when id in @gimbal_manager and component != known and (known == nil or component == core.component),
       do: %{core | state: %{core.state | gimbal_manager: component}, dirty: true}

  defp gimbal_manager(core, _frame), do: core

  defp report(core, actions, frame) do
    case MavCodec.decode(frame) do
      {:ok, message} -> Reporting.message(core, actions, frame, message)
      {:error, _unknown} -> {core, actions}
    end
  end

  defp heartbeat(core, actions, link, frame) do
    {:ok, message} = MavCodec.decode(frame)
    known = core.component
    sender = %Heartbeat{type: message.type, autopilot: message.autopilot, component: frame.component}

    cond do
      not Heartbeat.vehicle?(sender) or
          (known not in [nil, frame.component] and frame.component != 1) ->
        {core, actions}

      foreign?(core, frame, message) ->
        Collisions.other_vehicle(core, actions, frame)

      true ->
        autopilot_heartbeat(core, actions, link, frame, message)
    end
  end

  defp autopilot_heartbeat(core, actions, link, frame, message) do
    core = %{core | owner: Collision.Owner.proves(core.owner, core.path, frame.at)}
    {core, actions} = alive(%{spoken(core, frame) | component: frame.component}, actions, frame.at)
    core = core |> Services.heartbeat_heard(link, frame.at) |> Services.received(link, frame.id, frame.at)
    {core, actions} = early_texts({core, actions})
    content = {message.base_mode, message.custom_mode, message.system_status}
    suspicion = Collision.Suspicion.heartbeat(core.suspicion, core.path, content, frame.at)
    message(%{core | suspicion: suspicion}, actions, link, frame, message)
  end

  # Its radios may speak both versions, and what we send must not depend on which one was heard last: a fence of
  # version 1 is a mission. Its capabilities do not count. ArduPilot has the bit on ports that are set to MAVLink 1 as
  # well, and what it answers there has no mission_type either.
  defp spoken(core, %{version: 2, at: at}),
    do: %{core | version: 2, heartbeat: %{core.heartbeat | heard2: at}}

  defp spoken(%{heartbeat: %{heard2: heard}} = core, %{at: at})
       when heard != nil and abs(at - heard) <= @version2_us,
       do: core

  defp spoken(core, _version1), do: %{core | version: 1}

  # A frame says that the vehicle is another one, and does not come by the path by which the vehicle said what it is.
  defp foreign?(%{state: %{type: nil}}, _frame, _message), do: false

  defp foreign?(%{state: state} = core, frame, message),
    do: other?(core, state, frame, message) and not Collision.Owner.changes?(core.owner, core.path, frame.at)

  defp other?(core, state, frame, %{type: type, autopilot: autopilot}),
    do: core.component not in [nil, frame.component] or State.other?(state, type, autopilot)

  defp other?(_core, _state, _frame, %M.ComponentInformationBasic{}), do: true
  defp other?(_core, _state, _frame, _message), do: false

  # From before it was known which component is the autopilot.
  defp early_texts({core, actions}) do
    {early, texts} = Texts.release(core.texts)

    Enum.reduce(early, {%{core | texts: texts}, actions}, fn {link, frame}, {core, actions} ->
      decoded(core, actions, link, frame)
    end)
  end

  defp autopilot(core, actions, link, %{id: id, at: at} = frame) do
    core = if core.version == 1 and frame.version == 2, do: spoken(core, frame), else: core
    {core, actions} = alive(core, actions, at)
    core = Services.received(core, link, id, at)
    core = if id == @high_latency, do: Services.summary_heard(core, link, at), else: core

    if id in @reports, do: report(core, actions, frame), else: decoded(core, actions, link, frame)
  end

  defp decoded(core, actions, link, %{id: id, at: at} = frame) do
    if State.wants?(core.state, id, at) or id in @decoded do
      case MavCodec.decode(frame) do
        {:ok, message} -> message(core, actions, link, frame, message)
        {:error, _unknown} -> {core, actions}
      end
    else
      {core, actions}
    end
  end

  # A frame of the autopilot came. With the first one the detector learns that the vehicle is heard: its state, which
  # outlives a restart of the session, may say that the vehicle is lost.
  defp alive(%{status: :online, last_heard: nil} = core, actions, at),
    do: {%{core | last_heard: at}, [restored(core, at) | actions]}

  defp alive(%{status: :online} = core, actions, at),
    do: {%{after_silence(core, at) | last_heard: later(core.last_heard, at)}, actions}

  defp alive(core, actions, at) do
    core = after_silence(core, at)
    actions = if core.status == :lost, do: [restored(core, at) | actions], else: actions
    core = %{core | last_heard: later(core.last_heard, at), streams: Arbiter.back(core.streams, at)}
    Effects.status(core, actions, :online)
  end

  defp restored(core, at), do: {:observe, Observation.new(:restored, at, core.state.boot_ms)}

  # The vehicle may have been restarted meanwhile; its clock will tell.
  defp after_silence(%{last_heard: last, state: %{boot_ms: boot_ms}} = core, at)
       when is_integer(last) and is_integer(boot_ms) and at - last >= @silence_us,
       do: %{core | heard_again_at: at}

  defp after_silence(core, _at), do: core

  defp message(core, actions, _link, %{id: id, at: at} = frame, %{time_boot_ms: boot_ms} = message) do
    {clock, verdict} = BootClock.read(core.boot_clock, id, boot_ms, at)
    core = %{core | boot_clock: clock, heard_again_at: if(verdict == :behind, do: core.heard_again_at)}

    case verdict do
      :ok ->
        {core, actions} = Collisions.boot_time(core, actions, id, boot_ms, at)
        apply_message(%{core | state: State.at_boot(core.state, boot_ms)}, actions, frame, message)

      # Older than what is known, or the first sign of a reboot: either way, wait for the next one.
      :behind ->
        {core, actions} = Collisions.boot_time(core, actions, id, boot_ms, at)
        Collisions.late_message(core, actions, frame, message)

      :none ->
        {core, actions} = Collisions.boot_time(core, actions, id, boot_ms, at)
        apply_message(core, actions, frame, message)

      :reboot ->
        core = Services.rebooted(core, at)

        core = %{
          core
          | state: State.at_boot(core.state, boot_ms),
            # Everything may be different, even the hardware.
            collision_detector: Collision.Detector.new(),
            suspicion: Collision.Suspicion.rebooted(core.suspicion, at)
        }

        apply_message(core, [{:observe, Observation.new(:reboot, at, boot_ms)} | actions], frame, message)
    end
  end

  defp message(core, actions, link, %{id: @statustext} = frame, message) do
    {texts, done} = Texts.push(core.texts, link, frame, message)
    Reporting.texts({%{core | texts: texts}, actions}, done)
  end

  defp message(core, actions, _link, %{id: @param_value, at: at}, message) do
    case Params.read(message, core.state.autopilot) do
      {:ok, value} ->
        learn(
          {Services.param(core, value), add_param(actions, at, core.state.boot_ms, value)},
          value,
          at
        )

      :ignore ->
        {core, actions}
    end
  end

  defp message(core, actions, link, %{id: id} = frame, message) when id in @services,
    do: Services.message(core, actions, link, frame, message)

  defp message(core, actions, _link, frame, message), do: apply_message(core, actions, frame, message)

  defp apply_message(core, actions, %{id: @system_time}, _message), do: {core, actions}

  defp apply_message(core, actions, %{id: id, at: at} = frame, message) when id in @identifying do
    if foreign?(core, frame, message),
      do: Collisions.other_vehicle(core, actions, frame),
      else: applied(core, actions, id, message, at)
  end

  defp apply_message(core, actions, %{id: id, at: at}, message), do: applied(core, actions, id, message, at)

  defp applied(core, actions, id, message, at) do
    case State.apply(core.state, id, message, at) do
      {:invalid, _field} ->
        {core, [{:count, :invalid} | actions]}

      {state, groups} ->
        {core, actions} = Collisions.reading(%{core | state: state}, actions, {id, message}, at)
        {core, actions} = Effects.samples({core, actions}, groups, at)
        Effects.changed(core, actions, id, message, at)
    end
  end

  # See `State.Groups.Health`: the parameter may come before the SYS_STATUS that shows it.
  defp learn({core, actions}, {"FENCE_ENABLE", off, _index}, at) when off == 0 do
    state = State.put(core.state, :mission, State.Groups.Mission.fence_unknown(), at)
    Effects.check_digest(%{core | state: state}, actions, at)
  end

  # Without EXTENDED_SYS_STATE, which comes on request only.
  defp learn({core, actions}, {"Q_ENABLE", on, _index}, _at) when on != 0,
    do: {%{core | state: struct!(core.state, State.Groups.Mode.quadplane(core.state))}, actions}

  defp learn(acc, _value, _at), do: acc

  # Parameters of one read are one observation: a list of a thousand is not a thousand steps.
  defp add_param(
         [{:observe, %{kind: :params, at: at, boot_ms: boot_ms, data: values} = params} | rest],
         at,
         boot_ms,
         value
       ),
       do: [{:observe, %{params | data: values ++ [value]}} | rest]

  defp add_param(actions, at, boot_ms, value),
    do: [{:observe, Observation.new(:params, at, boot_ms, [value])} | actions]

  defp later(nil, at), do: at
  defp later(last, at), do: max(last, at)
end
