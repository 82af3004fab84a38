defmodule Aerie.Vehicle.Detector.Failsafe do
  @moduledoc """
  Failsafes: when one begins, why, what the vehicle does about it, and when it is over.

  A failsafe begins with whatever shows it first: the system status of the heartbeat, a text, a report (EVENT), or a mode that
  only the vehicle itself chooses. The first sign rarely says everything: ArduPilot's heartbeat comes milliseconds before the
  text with the cause, and a text before the change of the mode. So a failsafe is `pending` for a second, collects what comes
  meanwhile, and is reported with the time of its first sign as soon as cause and action are known, or when the second is
  over.

  Several failsafes can be `active` at once, each with its type and reason; the system status shows them together. A failsafe
  is over when a text or report says so, when the system status is normal again, or, if that never showed it, when the vehicle
  is disarmed.
  """

  alias Aerie.Vehicle.Detector.Step

  # How long a failsafe waits for its cause, and how far before it a change of the mode belongs to it.
  @settle_us 1_000_000
  # A cause that was named longer ago than this is not the cause of a failsafe.
  @reason_us 5_000_000
  # Within this time, a text repeats a failsafe in other words.
  @again_us 3_000_000
  @max_hints 8
  @max_active 16
  # Modes that only the vehicle itself chooses.
  @forced %{"AUTO_DESCEND" => "descend", "TERMINATION" => "terminate", "AVOID_ADSB" => "avoid_adsb"}

  defstruct pending: nil, active: %{}, hints: [], mode_change: nil

  @typedoc "What is known of a failsafe: `:type`, `:reason`, `:action`, `:delay`, `:text`, `:report`, `:found`."
  @type facts :: %{optional(atom()) => term()}
  @type key :: {type :: String.t(), reason :: String.t()}
  @typedoc """
  - `hints`: what may cause a failsafe, newest first: time, type, reason, and the text if it was one
  - `mode_change`: the last one: time, mode, position
  - `shown`: whether the system status has shown an active failsafe
  """
  @type t :: %__MODULE__{
          pending: map() | nil,
          active: %{key() => %{since: integer(), last: integer(), shown: boolean(), action: term()}},
          hints: [{integer(), String.t(), String.t(), String.t() | nil}],
          mode_change: {integer(), mode :: String.t(), where :: map() | nil} | nil
        }

  @doc "For how long a pending failsafe waits for its cause (us)."
  @spec settle_us() :: pos_integer()
  def settle_us, do: @settle_us

  @doc "Something that may be the cause of a failsafe: type, reason, and the text if it was one."
  @spec hint(t(), integer(), String.t(), String.t(), String.t() | nil) :: t()
  def hint(failsafe, at, type, reason, text \\ nil),
    do: %{failsafe | hints: Enum.take([{at, type, reason, text} | failsafe.hints], @max_hints)}

  @doc "It is `at`: reports a failsafe that has waited long enough."
  @spec due(t(), integer(), map()) :: {t(), [Step.t()]}
  def due(%{pending: %{at: since}} = failsafe, at, now) when at >= since + @settle_us or at < since,
    do: report(failsafe, now)

  def due(failsafe, _at, _now), do: {failsafe, []}

  @doc "What follows from the difference of two digests."
  @spec changed(t(), map(), map(), Step.moment()) :: {t(), [Step.t()]}
  def changed(failsafe, last, now, moment) do
    Enum.reduce([&status/4, &mode_change/4, &disarmed/4], {failsafe, []}, fn part, {failsafe, steps} ->
      {failsafe, more} = part.(failsafe, last, now, moment)
      {failsafe, steps ++ more}
    end)
  end

  defp mode_change(failsafe, %{mode: from}, %{mode: to} = now, moment) when from != to do
    failsafe = %{failsafe | mode_change: {moment.at, to, moment.where}}

    case @forced do
      %{^to => action} -> start(failsafe, %{by: :mode, action: action}, now, moment)
      _any -> if complete?(failsafe), do: report(failsafe, now), else: {failsafe, []}
    end
  end

  defp mode_change(failsafe, _last, _now, _moment), do: {failsafe, []}

  defp status(failsafe, last, %{failsafe: true} = now, moment) when not is_map_key(last, :failsafe),
    do: start(failsafe, %{by: :status, found: true}, now, moment)

  defp status(failsafe, %{failsafe: false}, %{failsafe: true} = now, moment),
    do: start(failsafe, %{by: :status}, now, moment)

  defp status(failsafe, %{failsafe: true}, %{failsafe: false} = now, moment),
    do: clear(failsafe, :all, "status", now, moment)

  defp status(failsafe, _last, _now, _moment), do: {failsafe, []}

  defp disarmed(failsafe, %{armed: true}, %{armed: false} = now, moment),
    do: clear(failsafe, :unshown, "disarmed", now, moment)

  defp disarmed(failsafe, _last, _now, _moment), do: {failsafe, []}

  @doc "A failsafe begins, or one that has begun is shown again. `:by` of the facts is what shows it."
  @spec start(t(), facts(), map(), Step.moment()) :: {t(), [Step.t()]}
  def start(%{pending: %{} = pending} = failsafe, facts, now, moment) do
    if other?(pending, facts) do
      {failsafe, steps} = report(failsafe, now)
      {failsafe, more} = start(failsafe, facts, now, moment)
      {failsafe, steps ++ more}
    else
      merged = Map.merge(pending, facts, fn _key, before, now -> now || before end)
      failsafe = %{failsafe | pending: merged}
      if complete?(failsafe), do: report(failsafe, now), else: {failsafe, []}
    end
  end

  def start(failsafe, facts, now, %{at: at} = moment) do
    case repeated(failsafe, facts, at) do
      nil ->
        failsafe = %{failsafe | pending: Map.merge(facts, %{at: at, moment: moment})}
        if complete?(failsafe), do: report(failsafe, now), else: {failsafe, []}

      key ->
        shown = facts.by == :status
        active = Map.update!(failsafe.active, key, &%{&1 | last: at, shown: &1.shown or shown})
        {%{failsafe | active: active}, []}
    end
  end

  defp other?(%{type: type}, %{type: other}), do: "unknown" not in [type, other] and type != other
  defp other?(_pending, _facts), do: false

  # The active failsafe that these facts show once more.
  defp repeated(failsafe, facts, at) do
    Enum.find_value(failsafe.active, fn {{type, reason} = key, one} ->
      same =
        case facts do
          %{by: :status} -> not one.shown and at - one.since <= @reason_us
          %{by: :mode} -> at - one.last <= @reason_us
          %{by: :text, type: "unknown"} -> at - one.last <= @again_us
          %{by: :text, type: other} -> type == other and at - one.last <= @again_us
          %{by: :report} = f -> {type, reason} == {f[:type], f[:reason]} and one.action == f.action
        end

      if same, do: key
    end)
  end

  defp complete?(%{pending: nil}), do: false
  defp complete?(%{pending: %{by: :report}}), do: true

  defp complete?(%{pending: pending} = failsafe),
    do: pending[:type] not in [nil, "unknown"] and action(failsafe) not in [nil, "none"]

  defp report(%{pending: nil} = failsafe, _now), do: {failsafe, []}

  defp report(%{pending: pending} = failsafe, now) do
    {type, reason, text} = cause(failsafe, pending, now)
    key = {type, reason}
    action = action(failsafe)
    known = failsafe.active[key]

    one = %{
      since: if(known, do: known.since, else: pending.at),
      last: pending.at,
      shown: now[:failsafe] == true,
      action: action
    }

    data = %{
      "type" => type,
      "reason" => reason,
      "action" => action,
      "delay" => pending[:delay],
      "text" => text,
      "report" => pending[:report],
      "mode" => now[:mode],
      "system_status" => now[:system_status]
    }

    data = if pending[:found], do: Map.put(data, "found", true), else: data
    active = if map_size(failsafe.active) < @max_active, do: failsafe.active, else: %{}

    step = %{Step.event("failsafe", data) | moment: moment(failsafe, pending.moment, now)}
    {%{failsafe | pending: nil, active: Map.put(active, key, one)}, [step]}
  end

  # A text has no position; what was seen within the second has.
  defp moment(failsafe, %{at: at, where: nil} = moment, now),
    do: %{moment | where: now[:where] || mode_change_position(failsafe.mode_change, at)}

  defp moment(_failsafe, moment, _now), do: moment

  defp mode_change_position({changed, _mode, where}, at) when abs(changed - at) <= @settle_us, do: where
  defp mode_change_position(_mode_change, _at), do: nil

  defp cause(failsafe, pending, now) do
    case pending do
      %{type: type, reason: reason} when type not in [nil, "unknown"] ->
        {type, precisely(failsafe, type, reason, pending), texts(failsafe, type, pending)}

      _unknown ->
        {type, reason, text} = why(failsafe, pending.at, now[:troubles] || [])
        {type, reason, pending[:text] || text}
    end
  end

  defp precisely(failsafe, type, type, pending) do
    Enum.find_value(failsafe.hints, type, fn {at, of, reason, _text} ->
      if of == type and reason != type and abs(at - pending.at) <= @settle_us, do: reason
    end)
  end

  defp precisely(_failsafe, _type, reason, _pending), do: reason

  # "Battery 1 is critical 9.80V" and "Battery Failsafe" belong to one failsafe.
  defp texts(failsafe, type, pending) do
    before =
      for {at, ^type, _, text} <- failsafe.hints, text != nil, abs(at - pending.at) <= @settle_us, do: text

    case Enum.uniq(Enum.reverse(before) ++ List.wrap(pending[:text])) do
      [] -> nil
      texts -> Enum.join(texts, "; ")
    end
  end

  @doc """
  The cause of a failsafe that begins `at`: what was named within five seconds before it, else what is wrong with the vehicle
  now.
  """
  @spec why(t(), integer(), [String.t()]) ::
          {type :: String.t(), reason :: String.t(), text :: String.t() | nil}
  def why(failsafe, at, troubles) do
    near =
      for {named, type, reason, text} <- failsafe.hints, at - named <= @reason_us, do: {type, reason, text}

    named = Enum.find(near, fn {type, _reason, _text} -> type != "unknown" end)

    case {named, troubles, near} do
      {nil, [trouble | _], _near} -> {trouble, trouble, nil}
      {nil, [], [{type, reason, text} | _]} -> {type, reason, text}
      {nil, [], []} -> {"unknown", "unknown", nil}
      {named, _troubles, _near} -> named
    end
  end

  @doc "The last hint of one of these types within five seconds before `at`: `{type, reason}` or nil."
  @spec last_hint(t(), integer(), [String.t()]) :: key() | nil
  def last_hint(failsafe, at, types) do
    Enum.find_value(failsafe.hints, fn {named, type, reason, _text} ->
      if type in types and at - named <= @reason_us, do: {type, reason}
    end)
  end

  defp action(%{pending: %{action: action}}) when action != nil, do: action
  defp action(%{pending: %{found: true}}), do: nil

  defp action(%{pending: %{at: at}, mode_change: {changed, mode, _where}})
       when abs(changed - at) <= @settle_us,
       do: mode |> String.downcase() |> String.replace_prefix("auto_", "")

  # The mode did not change.
  defp action(_failsafe), do: "none"

  @doc "Failsafes are over: all, those of a type, or those that the system status never showed."
  @spec clear(t(), :all | :unshown | {:type, String.t()}, String.t(), map(), Step.moment()) ::
          {t(), [Step.t()]}
  def clear(failsafe, which, by, now, %{at: at}) do
    {failsafe, steps} = report(failsafe, now)

    {over, active} =
      Map.split_with(failsafe.active, fn {{type, _reason}, one} ->
        which == :all or which == {:type, type} or (which == :unshown and not one.shown)
      end)

    ends =
      for {{type, reason}, one} <- Enum.sort_by(over, fn {key, one} -> {one.since, key} end) do
        duration = Step.seconds(one.since, at)

        Step.event("failsafe.cleared", %{
          "type" => type,
          "reason" => reason,
          "duration" => duration,
          "by" => by
        })
      end

    {%{failsafe | active: active}, steps ++ ends}
  end
end
