defmodule Aerie.Vehicle.Core.Intake do
  @moduledoc """
  From a frame to what it means for the vehicle: whose it is, whether it is worth decoding, which part of the core it
  concerns.
  """

  alias Aerie.Mavlink.BootClock
  alias Aerie.Vehicle.{Core, Doubt, Heard, Kind, Params, State, StatusText, Streams, Twin}
  alias Aerie.Vehicle.Core.{Dealings, Effects, Reporting}

  @heartbeat 0
  @system_time 2
  @param_value 22
  @high_latency 235
  @statustext 253
  # EVENT, CURRENT_EVENT_SEQUENCE, RESPONSE_EVENT_ERROR
  @reports [410, 411, 413]
  # For how long a second link's copy of a text may come after the first one's.
  @copy_us 5_000_000
  # For how long the same text by the same link, with the same number, is one that came twice.
  @again_us 1_000_000
  # PING, COMMAND_ACK, TIMESYNC, MESSAGE_INTERVAL: what `Dealings.message/5` is for.
  @dealings [4, 77, 111, 244]
  # HEARTBEAT, SYSTEM_TIME, ATTITUDE, GLOBAL_POSITION_INT, AUTOPILOT_VERSION: by which two vehicles are told apart.
  @telling [0, 2, 30, 33, 148]
  # ... of which these say more than for how long they have run.
  @signs [0, 33, 148]
  @position 33
  # No vehicle here is faster.
  @fast_m_s 100

  # A vehicle that restarts says nothing for longer than this.
  @silence_us 2_000_000
  # Texts that came before the first heartbeat (`Aerie.Router.Early` holds as many).
  @max_early 16

  @doc "One frame of the vehicle's system. The actions come newest first."
  @spec frame(Core.t(), [Core.action()], term(), struct()) :: {Core.t(), [Core.action()]}
  def frame(core, actions, link, frame) do
    # Whoever it is that speaks: the way to this system works.
    core = %{core | heard: Heard.frame(core.heard, link, byte_size(frame.bytes), frame.at)}

    cond do
      frame.id == @heartbeat ->
        heartbeat(core, actions, link, frame)

      frame.component == core.component ->
        autopilot(core, actions, link, frame)

      core.component == nil and frame.id == @statustext ->
        {%{core | early: Enum.take(core.early ++ [{link, frame}], @max_early)}, actions}

      core.component == nil and frame.id == @high_latency ->
        autopilot(%{core | component: frame.component}, actions, link, frame)

      # Not the autopilot's, but the vehicle's all the same.
      core.component != nil and frame.id in @reports ->
        report(core, actions, frame)

      true ->
        {core, actions}
    end
  end

  @doc """
  One frame of another vehicle that uses this one's system id (`Aerie.Vehicle.Rivals`): nothing of it is state, but whether
  there still are two is seen by it.
  """
  @spec rival(Core.t(), [Core.action()], struct()) :: {Core.t(), [Core.action()]}
  def rival(core, actions, %{id: id, at: at} = frame) when id in @telling do
    with true <- frame.component == core.component, {:ok, message} <- MavCodec.decode(frame) do
      {core, actions} = rival_clock(core, actions, id, message, at)
      rival_sign(core, actions, id, message, at)
    else
      _nothing -> {core, actions}
    end
  end

  def rival(core, actions, _frame), do: {core, actions}

  defp rival_clock(core, actions, id, %{time_boot_ms: boot_ms}, at),
    do: Effects.boot(core, actions, id, boot_ms, at)

  defp rival_clock(core, actions, _id, _message, _at), do: {core, actions}

  defp rival_sign(core, actions, id, _message, _at) when id not in @signs, do: {core, actions}

  defp rival_sign(core, actions, id, message, at) do
    # As this vehicle's state would read it, which is not touched.
    case State.apply(%State{}, id, message, at) do
      {:invalid, _field} ->
        {core, actions}

      {state, _groups} ->
        {seen, actions} = Effects.twin_of(%{core | state: state}, actions, {id, message}, at)
        {%{seen | state: core.state}, actions}
    end
  end

  # A frame of a late link says where the vehicle was. Where it cannot have been so shortly before is another one: two that
  # were switched on within half a minute look like a late link otherwise.
  defp elsewhere(core, actions, %{id: @position, at: at}, message) do
    with %{lat: lat, lon: lon} when lat != nil <- State.data(core.state, :position),
         known when is_integer(known) <- core.state.boot_ms,
         late_s = abs(known - message.time_boot_ms) / 1000,
         true <-
           Twin.distance_m({lat, lon}, {message.lat / 1.0e7, message.lon / 1.0e7}) > 1000 + late_s * @fast_m_s do
      rival_sign(core, actions, @position, message, at)
    else
      _on_its_way -> {core, actions}
    end
  end

  defp elsewhere(core, actions, _frame, _message), do: {core, actions}

  defp report(core, actions, frame) do
    case MavCodec.decode(frame) do
      {:ok, message} -> Reporting.message(core, actions, frame, message)
      {:error, _unknown} -> {core, actions}
    end
  end

  defp heartbeat(core, actions, link, frame) do
    {:ok, message} = MavCodec.decode(frame)
    known = core.component

    if Kind.vehicle?(message.type, message.autopilot) and
         (known in [nil, frame.component] or frame.component == 1) do
      {core, actions} = alive(%{core | component: frame.component, version: frame.version}, actions, frame.at)
      core = core |> Dealings.beat_heard(link, frame.at) |> Dealings.heard(link, frame.id, frame.at)
      {core, actions} = early({core, actions})
      said = {message.base_mode, message.custom_mode, message.system_status}
      core = %{core | doubt: Doubt.beat(core.doubt, core.way, said, frame.at)}
      message(core, actions, link, frame, message)
    else
      {core, actions}
    end
  end

  defp early({%{early: []}, _actions} = acc), do: acc

  # What the autopilot said before anybody knew that it is one.
  defp early({%{early: early, component: component} = core, actions}) do
    for {link, %{component: ^component} = frame} <- early, reduce: {%{core | early: []}, actions} do
      {core, actions} -> autopilot_message(core, actions, link, frame)
    end
  end

  defp autopilot(core, actions, link, %{id: id, at: at} = frame) do
    {core, actions} = alive(core, actions, at)
    core = Dealings.heard(core, link, id, at)
    core = if id == @high_latency, do: Dealings.summary_heard(core, link, at), else: core

    if id in @reports, do: report(core, actions, frame), else: autopilot_message(core, actions, link, frame)
  end

  defp autopilot_message(core, actions, link, %{id: id, at: at} = frame) do
    if State.wants?(core.state, id, at) or id in [@system_time, @param_value, @statustext | @dealings] do
      case MavCodec.decode(frame) do
        {:ok, message} -> message(core, actions, link, frame, message)
        {:error, _unknown} -> {core, actions}
      end
    else
      {core, actions}
    end
  end

  # Something of the autopilot came. The first time, what is kept of an earlier life of the vehicle may say that it is lost.
  defp alive(%{status: :online, last_heard: nil} = core, actions, at),
    do: {%{core | last_heard: at}, [{:observe, {:restored, at, core.state.boot_ms}} | actions]}

  defp alive(%{status: :online} = core, actions, at),
    do: {%{silent(core, at) | last_heard: later(core.last_heard, at)}, actions}

  defp alive(core, actions, at) do
    core = silent(core, at)
    observed = if core.status == :lost, do: [{:observe, {:restored, at, core.state.boot_ms}}], else: []
    last_heard = later(core.last_heard, at)

    core = %{core | last_heard: last_heard, streams: Streams.Arbiter.back(core.streams, at)}

    Effects.status(core, observed ++ actions, :online)
  end

  # It may have been restarted meanwhile; its clock will tell.
  defp silent(%{last_heard: last, state: %{boot_ms: boot_ms}} = core, at)
       when is_integer(last) and is_integer(boot_ms) and at - last >= @silence_us,
       do: %{core | back: at}

  defp silent(core, _at), do: core

  defp message(core, actions, _link, frame, %{time_boot_ms: boot_ms} = message) do
    {clock, verdict} = BootClock.read(core.clock, frame.id, boot_ms, frame.at)
    core = %{core | clock: clock, back: if(verdict == :behind, do: core.back)}

    case verdict do
      :ok ->
        {core, actions} = Effects.boot(core, actions, frame.id, boot_ms, frame.at)
        apply_message(%{core | state: State.at_boot(core.state, boot_ms)}, actions, frame, message)

      # Older than what is known, or the first sign of a reboot; either way it is worth a moment's wait.
      :behind ->
        {core, actions} = Effects.boot(core, actions, frame.id, boot_ms, frame.at)
        elsewhere(core, actions, frame, message)

      :none ->
        {core, actions} = Effects.boot(core, actions, frame.id, boot_ms, frame.at)
        apply_message(core, actions, frame, message)

      :reboot ->
        core = Dealings.rebooted(core, frame.at)

        core = %{
          core
          | state: State.at_boot(core.state, boot_ms),
            twin: Twin.rebooted(core.twin),
            doubt: Doubt.rebooted(core.doubt, frame.at)
        }

        apply_message(core, [{:observe, {:reboot, frame.at, boot_ms}} | actions], frame, message)
    end
  end

  defp message(core, actions, link, %{id: @statustext} = frame, message) do
    {first?, core} = first_copy(core, link, frame)

    if first? do
      {texts, done} = StatusText.push(core.texts, frame.component, message, frame.at)
      Reporting.texts({%{core | texts: texts}, actions}, done)
    else
      {core, actions}
    end
  end

  defp message(core, actions, _link, %{id: @param_value} = frame, message) do
    case Params.read(message, core.state.autopilot) do
      {:ok, value} -> {Dealings.param(core, value), add_param(actions, frame.at, core.state.boot_ms, value)}
      :ignore -> {core, actions}
    end
  end

  defp message(core, actions, link, %{id: id} = frame, message) when id in @dealings,
    do: Dealings.message(core, actions, link, frame, message)

  defp message(core, actions, _link, frame, message), do: apply_message(core, actions, frame, message)

  defp apply_message(core, actions, %{id: @system_time}, _message), do: {core, actions}

  defp apply_message(core, actions, %{id: id, at: at}, message) do
    case State.apply(core.state, id, message, at) do
      {:invalid, _field} ->
        {core, [{:count, :invalid} | actions]}

      {state, groups} ->
        {core, actions} = Effects.twin_of(%{core | state: state}, actions, {id, message}, at)
        {core, actions} = Enum.reduce(groups, {core, actions}, &Effects.sample(&2, &1, at))
        core |> Effects.changed(actions, id, message, at) |> Effects.show(at)
    end
  end

  # A second link brings the same frame again, or the network the same datagram: same number, same content. (The number alone
  # would not do, R7; by one link it comes round after 256 frames.)
  defp first_copy(core, link, frame) do
    key = {frame.component, frame.seq, frame.payload}

    case core.recent do
      %{^key => {other, at}} when other != link and frame.at - at < @copy_us ->
        {false, core}

      %{^key => {_same, at}} when frame.at - at < @again_us ->
        {false, core}

      recent ->
        recent =
          if map_size(recent) < 64,
            do: recent,
            else: Map.filter(recent, fn {_, {_, at}} -> frame.at - at < @copy_us end)

        recent = if map_size(recent) < 256, do: recent, else: %{}
        {true, %{core | recent: Map.put(recent, key, {link, frame.at})}}
    end
  end

  # What came in one read is one observation: a list of a thousand parameters is not a thousand steps.
  defp add_param([{:observe, {:params, at, boot_ms, values}} | actions], at, boot_ms, value) do
    [{:observe, {:params, at, boot_ms, values ++ [value]}} | actions]
  end

  defp add_param(actions, at, boot_ms, value), do: [{:observe, {:params, at, boot_ms, [value]}} | actions]

  defp later(nil, at), do: at
  defp later(last, at), do: max(last, at)
end
