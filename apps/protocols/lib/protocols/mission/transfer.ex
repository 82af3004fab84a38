defmodule Protocols.Mission.Transfer do
  @moduledoc """
  One transfer of a mission, a fence or a list of rally points: `handle(transfer, event) -> {transfer, actions}`. Rules W1-W8.

  Uploading or clearing a plan always ends with reading it back, because the result is what the vehicle has, not what it
  acknowledged. If the vehicle refused it or did not answer, or it was cancelled, the transfer is cancelled (W6), waits until no message can
  still be under way, and then reads. If the firmware checks a plan after acknowledging it, the
  transfer waits for the outcome.

  Events, all with the time `now` in microseconds of a clock that is never set:

    * `{:start, now}`
    * `{:message, message, source, now}` - a message of the vehicle that `listens/0` asks for
    * `{:cancel, now}`
    * `{:rebooted, now}` - the vehicle has rebooted
    * `{:tick, now}` - at `wake_at/1` at the latest

  Actions, to be carried out in order:

    * `{:send, message}`
    * `{:progress, %{phase: :sending | :reading | :checking, done: n, total: n}}` - at most a hundred per phase
    * `{:result, result}` - `t:Protocols.Mission.Result.t/0`, once, as the last
  """

  alias Protocols.Mission.{Item, Result}
  alias Protocols.Mission.Transfer.{Compare, Outcome, Read, Retry, Write}
  alias Protocols.StatusText
  alias MavCodec.Messages, as: M

  # The firmwares store fewer items than this: PX4 2000, ArduPilot 724 to about 3000 with a file.
  @limit 5_000
  @notice 5
  @most_said 3
  @listens [M.MissionRequest, M.MissionRequestInt, M.MissionCount, M.MissionItemInt, M.MissionAck] ++
             [M.MissionCurrent, M.Event, M.Statustext]

  @enforce_keys [:op, :type, :protocol, :kind, :target, :us, :until]
  defstruct [
    :op,
    :type,
    :protocol,
    :kind,
    :target,
    :us,
    :until,
    :retry,
    :part,
    :cause,
    :opaque_id,
    :verdict,
    :due,
    :started,
    :read_at,
    item_us: 0,
    items: [],
    remarks: [],
    phase: :new,
    heard?: false,
    changed?: false,
    looks: 0,
    sent: 0,
    shown: nil,
    texts: StatusText.new(),
    said: []
  ]

  @type op :: {:upload, [Item.t()]} | :clear | :download
  @type phase :: :new | :writing | :settling | :reading | :watching | :done
  @type t :: %__MODULE__{}
  @type event ::
          {:start, integer()}
          | {:message, struct(), {0..255, 0..255}, integer()}
          | {:cancel, integer()}
          | {:rebooted, integer()}
          | {:tick, integer()}
  @type action :: {:send, struct()} | {:progress, map()} | {:result, Result.t()}

  @doc "The most items that a plan may have."
  @spec limit() :: pos_integer()
  def limit, do: @limit

  @doc "The modules of the messages that a transfer needs."
  @spec listens() :: [module()]
  def listens, do: @listens

  @doc """
  A transfer of `type` 0 (mission), 1 (fence) or 2 (rally points). Items are those of the wire (`Protocols.Mission.Onboard`).

    * `:protocol` - the firmware (`Protocols.Mission.Firmware`); `:kind` - the kind of vehicle: `copter`, `plane` and so on
    * `:target` - system and component of the vehicle; `:us` - ours
    * `:until` - the deadline, by the clock of the events
    * `:rtt` - the measured round trip in microseconds, or nil
    * `:item_us` - what the deadline grows by for each item that the vehicle says it has; by default 0
  """
  @spec new(op(), 0..2, keyword()) :: {:ok, t()} | {:error, String.t()}
  def new(op, type, options) do
    items = if match?({:upload, _items}, op), do: elem(op, 1), else: []

    if length(items) > @limit do
      {:error, "the plan has #{length(items)} items; at most #{@limit} can be sent"}
    else
      {:ok,
       %__MODULE__{
         op: if(op == {:upload, []}, do: :clear, else: if(is_tuple(op), do: :upload, else: op)),
         type: type,
         items: items,
         protocol: Keyword.fetch!(options, :protocol),
         kind: Keyword.fetch!(options, :kind),
         target: Keyword.fetch!(options, :target),
         us: Keyword.fetch!(options, :us),
         until: Keyword.fetch!(options, :until),
         item_us: Keyword.get(options, :item_us, 0),
         retry: Retry.new(options[:rtt])
       }}
    end
  end

  @doc "When the next `:tick` is due; nil before the start and after the end."
  @spec wake_at(t()) :: integer() | nil
  def wake_at(%{phase: phase}) when phase in [:new, :done], do: nil
  def wake_at(%{phase: phase} = t) when phase in [:settling, :watching], do: min(t.due, t.until)
  def wake_at(t), do: min(t.retry.due, t.until)

  @doc "Handles an event."
  @spec handle(t(), event()) :: {t(), [action()]}
  def handle(t, event) do
    {t, actions} = event({t, []}, event)
    {t, Enum.reverse(actions)}
  end

  defp event({%{phase: :done}, _actions} = acc, _event), do: acc

  defp event({%{phase: :new} = t, actions}, {:start, now}) do
    t = %{t | started: now}

    cond do
      now >= t.until -> finish({t, actions}, {:expired, "its deadline has passed", :old}, now)
      t.op == :download -> read({t, actions}, now)
      true -> write({t, actions}, now)
    end
  end

  defp event({%{phase: :new} = t, actions}, {:cancel, now}),
    do: finish({%{t | started: now}, actions}, {:cancelled, "it had not been started", :old}, now)

  defp event({%{phase: :new}, _actions} = acc, _event), do: acc

  defp event({t, _actions} = acc, {:message, message, source, now}) do
    if source == t.target and ours?(message, t.us),
      do: acc |> noted(message) |> said(message, now) |> message(message, now),
      else: acc
  end

  defp event(acc, {:cancel, now}), do: cancel(acc, now)
  defp event(acc, {:rebooted, now}), do: rebooted(acc, now)

  defp event({t, _actions} = acc, {:tick, now}) do
    cond do
      now >= t.until -> expired(acc, now)
      now >= wake_at(t) -> due(acc, now)
      true -> acc
    end
  end

  # A message without a target field, or with target 0, is for everybody.
  defp ours?(%{target_system: system, target_component: component}, {our_system, our_component}),
    do: system in [0, our_system] and component in [0, our_component]

  defp ours?(_broadcast, _us), do: true

  # --- Reports about the plan itself, at any time after it was sent completely

  defp noted({%{phase: phase, op: op} = t, actions}, message)
       when (phase in [:reading, :settling, :watching] and op != :download) or
              (phase == :writing and t.part.last_sent?) do
    said = t.protocol.plan_verdict(message, t.type, t.opaque_id)
    {%{t | verdict: Outcome.verdict(t.verdict, said)}, actions}
  end

  defp noted(acc, _message), do: acc

  # What it says meanwhile may be why it refuses.
  defp said({%{op: op} = t, actions}, %M.Statustext{severity: severity} = message, now)
       when op != :download and severity <= @notice do
    {texts, whole} = StatusText.push(t.texts, t.target, message, now)
    said = Enum.uniq(t.said ++ Enum.map(whole, & &1.text))
    {%{t | texts: texts, said: Enum.take(said, -@most_said)}, actions}
  end

  defp said(acc, _message, _now), do: acc

  # --- Messages

  defp message({%{phase: :writing} = t, _actions} = acc, message, now) do
    case Write.handle(t.part, message) do
      :ignore ->
        acc

      {:next, part, answer} ->
        t = %{t | part: part, heard?: true, changed?: true, retry: Retry.answered(t.retry, now)}
        t = %{t | retry: Retry.sent(t.retry, :item, now)}
        {t, elem(acc, 1)} |> progress(:sending, Write.done(part), length(t.items)) |> send_it(answer)

      {:acked, opaque_id} ->
        t = %{t | cause: :acked, opaque_id: opaque_id, heard?: true, retry: Retry.answered(t.retry, now)}
        read({t, elem(acc, 1)}, now)

      {:doubt, result} ->
        settle({%{t | heard?: true, cause: {:doubt, result}}, elem(acc, 1)}, now)

      {:refused, result} ->
        refused({%{t | heard?: true}, elem(acc, 1)}, result, now)
    end
  end

  # If the vehicle still requests items, it gets the message that the upload is over (W6).
  defp message({%{phase: phase, op: :upload} = t, _actions} = acc, %module{mission_type: type}, _now)
       when module in [M.MissionRequest, M.MissionRequestInt] and phase in [:settling, :reading, :watching] and
              type == t.type do
    send_it(acc, Write.cancel(Write.new(t.type, t.target, [])))
  end

  defp message({%{phase: :reading} = t, _actions} = acc, message, now) do
    case Read.handle(t.part, message) do
      :ignore ->
        acc

      {:next, part, request} ->
        t = %{t | part: part, heard?: true, retry: Retry.answered(t.retry, now)}
        t = %{t | retry: Retry.sent(t.retry, if(part.count, do: :item, else: :first), now)}
        t = if part.next == 0, do: %{t | until: max(t.until, now + (part.count || 0) * t.item_us)}, else: t
        {t, elem(acc, 1)} |> progress(:reading, part.next, part.count || 0) |> send_it(request)

      {:done, items, opaque_id, ack} ->
        t = %{t | retry: Retry.answered(t.retry, now), opaque_id: opaque_id || t.opaque_id}
        {t, elem(acc, 1)} |> send_it(ack) |> was_read(items, now)

      {:refused, reason} ->
        unreadable(acc, Outcome.refusal(reason), now)
    end
  end

  defp message({%{phase: :watching} = t, _actions} = acc, _message, now) do
    if Outcome.final?(t.verdict), do: checked(acc, now), else: acc
  end

  defp message(acc, _message, _now), do: acc

  # --- Time

  defp due({%{phase: :settling}, _actions} = acc, now), do: read(acc, now)
  defp due({%{phase: :watching}, _actions} = acc, now), do: checked(acc, now)

  defp due({t, actions}, now) do
    case Retry.again(t.retry, now) do
      {:again, retry} -> repeat({%{t | retry: retry}, actions}, now)
      :give_up -> silent({t, actions}, now)
    end
  end

  defp repeat({%{phase: :writing} = t, actions}, _now) do
    {part, message} = Write.again(t.part, t.retry.tries)
    send_it({%{t | part: part}, actions}, message)
  end

  # A vehicle that has ended the transfer ignores requests for items.
  defp repeat({t, actions} = acc, now) do
    case Retry.stalled?(t.retry, now) && Read.begin_again(t.part) do
      {:ok, part} ->
        t = %{t | part: part, retry: Retry.sent(t.retry, :first, now)}
        send_it({t, actions}, Read.request(part))

      :too_often ->
        finish(acc, Outcome.stalled(t.op, t.cause), now)

      _answers_or_not_begun ->
        send_it(acc, Read.request(t.part))
    end
  end

  defp silent({%{phase: :writing, heard?: false}, _actions} = acc, now),
    do: finish(acc, {:timeout, "the vehicle does not answer", :unknown}, now)

  defp silent({%{phase: :writing} = t, actions}, now), do: settle({%{t | cause: :silent}, actions}, now)

  defp silent({%{op: :download}, _actions} = acc, now),
    do: finish(acc, {:timeout, "the vehicle does not answer", :unknown}, now)

  defp silent(acc, now), do: unreadable(acc, "the vehicle does not answer", now)

  # The deadline passed: there is no time to find out more.
  defp expired({t, _actions} = acc, now) do
    acc = stopped(acc)
    reason = "its deadline passed"

    case t.phase do
      :watching -> checked(acc, now)
      _other when t.op == :download -> finish(acc, {:timeout, reason, :unknown}, now)
      :writing -> finish(acc, {:timeout, reason <> " before everything was sent", on_board_unread(t)}, now)
      _reading -> finish(acc, {:unknown, reason <> " before the plan was read back", :unknown}, now)
    end
  end

  # Until the vehicle requests an item, it has none of them.
  defp on_board_unread(%{changed?: false, part: %{items: items}}) when items != {}, do: :old
  defp on_board_unread(_t), do: :unknown

  # --- Phases

  defp write({t, actions}, now) do
    part = Write.new(t.type, t.target, t.items)
    t = %{t | phase: :writing, part: part, retry: Retry.sent(t.retry, :first, now)}
    {t, actions} |> progress(:sending, 0, length(t.items)) |> send_it(Write.current(part))
  end

  # The vehicle refused the whole plan before it requested an item.
  defp refused({%{changed?: false, op: :upload}, _actions} = acc, result, now),
    do: finish(acc, {:rejected, Outcome.refusal(result), :old}, now)

  defp refused({t, actions}, result, now), do: settle({%{t | cause: {:refused, result}}, actions}, now)

  defp settle({t, actions}, now) do
    t = %{t | phase: :settling, due: now + Retry.quiet(t.retry)}
    stopped({t, actions})
  end

  defp stopped({%{op: :upload} = t, _actions} = acc),
    do: send_it(acc, Write.cancel(Write.new(t.type, t.target, [])))

  defp stopped({%{phase: :reading} = t, _actions} = acc), do: send_it(acc, Read.stop(t.part))
  defp stopped(acc), do: acc

  defp read({t, actions}, now) do
    part = Read.new(t.type, t.target, @limit)
    t = %{t | phase: :reading, part: part, read_at: now, retry: Retry.sent(t.retry, :first, now)}
    send_it({t, actions}, Read.request(part))
  end

  defp was_read({%{op: :download}, _actions} = acc, items, now),
    do: finish(acc, {:completed, nil, :read}, now, items: items)

  defp was_read({t, actions}, items, now) do
    comparison = Compare.plans(t.items, items, t.type, t.protocol, t.kind)

    {mismatch, t} =
      case comparison do
        {:same, remarks} -> {nil, %{t | remarks: remarks}}
        {:differs, seq, _how} -> {seq, t}
      end

    case Outcome.read_back(comparison, t.cause, t.looks == 0) do
      :check -> watch({t, actions}, items, now)
      :again -> settle({%{t | looks: 1}, actions}, now)
      outcome -> finish({t, actions}, outcome, now, items: items, mismatch: mismatch)
    end
  end

  # If the cancellation was lost, the vehicle may still be in the middle of the upload.
  defp unreadable({%{op: :download}, _actions} = acc, reason, now),
    do: finish(acc, {:rejected, reason, :unknown}, now)

  defp unreadable({%{looks: looks} = t, actions}, _reason, now) when looks < 3 and t.heard?,
    do: settle({%{t | looks: looks + 1, heard?: false}, actions}, now)

  defp unreadable({t, _actions} = acc, reason, now),
    do: finish(acc, Outcome.unreadable(t.cause, reason), now)

  # The firmware may still reject it.
  defp watch({t, actions}, items, now) do
    watch = if t.op == :clear, do: 0, else: t.protocol.plan_watch_us(t.type)
    t = %{t | phase: :watching, due: now + watch, part: items}

    if watch == 0 or Outcome.final?(t.verdict),
      do: checked({t, actions}, now),
      else: progress({t, actions}, :checking, 0, 1)
  end

  defp checked({t, _actions} = acc, now) do
    # A fence that is not rejected is valid: no message confirms it.
    announced? = t.type == 0 and t.op != :clear and t.protocol.plan_watch_us(t.type) > 0
    finish(acc, Outcome.checked(t.verdict, announced?), now, items: t.part)
  end

  # --- Cancelling, reboot

  defp cancel({%{op: :download}, _actions} = acc, now),
    do: acc |> stopped() |> finish({:cancelled, nil, :unknown}, now)

  defp cancel({%{phase: :writing} = t, actions}, now), do: settle({%{t | cause: :cancelled}, actions}, now)
  # For the vehicle the transfer is over; reading shows what it has.
  defp cancel(acc, _now), do: acc

  defp rebooted({%{phase: :writing} = t, actions}, now), do: settle({%{t | cause: :rebooted}, actions}, now)
  defp rebooted({%{phase: :reading}, _actions} = acc, now), do: read(acc, now)
  defp rebooted(acc, _now), do: acc

  # --- Ends

  defp finish({t, actions}, {status, reason, on_board}, now, more \\ []) do
    reason = if status == :rejected and t.verdict == nil, do: Outcome.said(reason, t.said), else: reason
    result = %Result{status: status, reason: reason, on_board: on_board, ms: div(now - t.started, 1000)}
    known = t |> Map.take([:remarks, :opaque_id, :read_at, :sent]) |> Map.to_list()
    result = struct!(result, known ++ more)
    {%{t | phase: :done, part: nil, items: []}, [{:result, result} | actions]}
  end

  defp send_it({t, actions}, message), do: {%{t | sent: t.sent + 1}, [{:send, message} | actions]}

  defp progress({t, actions}, phase, done, total) do
    share = {phase, div(100 * done, max(total, 1))}

    if t.shown == share or (elem(t.shown || {nil, 0}, 0) == phase and elem(t.shown, 1) > elem(share, 1)),
      do: {t, actions},
      else: {%{t | shown: share}, [{:progress, %{phase: phase, done: done, total: total}} | actions]}
  end
end
