defmodule Aerie.Vehicle.Events.Detector.Failsafe do
  @moduledoc """
  Failsafes: when one begins, why, what the vehicle does about it, and when it is over.

  A failsafe begins with whatever shows it first: the system status of the heartbeat, a text, a report (EVENT), or a mode that
  only the vehicle itself chooses. The first sign rarely says everything: ArduPilot's heartbeat comes milliseconds before the
  text with the cause, and a text before the change of the mode. So a failsafe is `pending`, collects what comes meanwhile, and
  is reported with the time of its first sign as soon as cause and action are known, or when the time for that is over: a
  second after a heartbeat, which shows the mode as well, and two heartbeats after a text, which does not.

  Some signs are a failsafe only if the vehicle does something about them (`needs_action`): a breach of its fence, which
  ArduPilot shows neither in its status nor in a text about a failsafe, and a second text about a failsafe without an action.

  Several failsafes can be `active` at once, each with its type and reason; the system status shows them together. A failsafe
  is over when a text or report says so, when the system status is normal again, or, if that never showed it, when the vehicle
  is disarmed, or armed again: what was disarmed had nothing to act on.
  """

  alias Aerie.Vehicle.Events.Detector.Step

  # How long a failsafe waits for its cause, and how far before it a change of the mode belongs to it.
  @settle_us 1_000_000
  # The mode comes with the heartbeat, once a second; the first one after a text may be lost.
  @heartbeats_us 2_200_000
  # A cause that was named longer ago than this is not the cause of a failsafe.
  @reason_us 5_000_000
  # Within this time, a text repeats a failsafe in other words.
  @again_us 3_000_000
  @max_hints 8
  @max_active 16
  # The vehicle's action at a fence (FENCE_ACTION of ArduCopter, ArduPlane and Rover).
  @fence_modes ~w(RTL SMART_RTL LAND BRAKE QRTL QLAND AUTOLAND GUIDED HOLD)
  # Modes that only the vehicle itself chooses.
  @forced %{"AUTO_DESCEND" => "descend", "TERMINATION" => "terminate", "AVOID_ADSB" => "avoid_adsb"}

  defstruct pending: nil, active: %{}, hints: [], mode_change: nil

  @typedoc """
  What is known of a failsafe: `:type`, `:reason`, `:action`, `:delay`, `:text`, `:report`, `:found`; `:more`: another text
  about it may follow; `:needs_action`: only with an action is it a failsafe.
  """
  @type facts :: %{optional(atom()) => term()}
  @typedoc "What shows a failsafe: the system status, a text, a report, a mode or a broken fence."
  @type sign :: :status | :text | :report | :mode | :fence
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

  @doc "For how long a pending failsafe that this has shown waits for its cause and action (us)."
  @spec settle_us(sign()) :: pos_integer()
  def settle_us(sign) when sign in [:text, :fence], do: @heartbeats_us
  def settle_us(_sign), do: @settle_us

  @doc "Something that may be the cause of a failsafe: type, reason, and the text if it was one."
  @spec hint(t(), integer(), String.t(), String.t(), String.t() | nil) :: t()
  def hint(failsafe, at, type, reason, text \\ nil),
    do: %{failsafe | hints: Enum.take([{at, type, reason, text} | failsafe.hints], @max_hints)}

  @doc "It is `at`: reports a failsafe that has waited long enough."
  @spec due(t(), integer(), map()) :: {t(), [Step.t()]}
  def due(%{pending: %{at: since} = pending} = failsafe, at, now) do
    wait_us = if action(failsafe) in [nil, "none"], do: wait_us(pending), else: @settle_us
    if at < since or at >= since + wait_us, do: report(failsafe, now), else: {failsafe, []}
  end

  def due(failsafe, _at, _now), do: {failsafe, []}

  # A heartbeat that shows the failsafe shows the mode as well.
  defp wait_us(%{status: true}), do: @settle_us
  defp wait_us(%{by: by}), do: settle_us(by)

  @doc "The events that follow from the difference of two digests."
  @spec changed(t(), map(), map(), Step.moment()) :: {t(), [Step.t()]}
  def changed(failsafe, last, now, moment) do
    Enum.reduce([&mode_change/4, &status/4, &disarmed/4], {failsafe, []}, fn part, {failsafe, steps} ->
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
    do: start(failsafe, %{by: :status, status: true, found: true}, now, moment)

  defp status(failsafe, %{failsafe: false}, %{failsafe: true} = now, moment),
    do: start(failsafe, %{by: :status, status: true}, now, moment)

  defp status(failsafe, %{failsafe: true}, %{failsafe: false} = now, moment),
    do: clear(failsafe, :shown, "status", now, moment)

  defp status(failsafe, _last, _now, _moment), do: {failsafe, []}

  defp disarmed(failsafe, %{armed: true}, %{armed: false} = now, moment),
    do: clear(failsafe, :unshown, "disarmed", now, moment)

  # One that a disarmed vehicle told of. What it told of just now may be about the flight that begins.
  defp disarmed(%{active: active} = failsafe, %{armed: false}, %{armed: true} = now, moment) do
    {new, before} = Map.split_with(active, fn {_key, one} -> moment.at - one.last <= @reason_us end)
    {failsafe, steps} = clear(%{failsafe | active: before}, :unshown, "armed", now, moment)
    {%{failsafe | active: Map.merge(failsafe.active, new)}, steps}
  end

  defp disarmed(failsafe, _last, _now, _moment), do: {failsafe, []}

  @doc "The failsafes that are active now; `facts` are the last digest."
  @spec conditions(t(), map()) :: [Aerie.Vehicle.Events.Detector.condition()]
  def conditions(failsafe, facts) do
    for {{type, reason} = key, one} <- failsafe.active, one.shown or facts[:armed] != false do
      data = %{"type" => type, "reason" => reason, "action" => one.action}
      %{type: "failsafe", subject: key, since: one.since, data: data}
    end
  end

  @doc "A failsafe begins, or one that has begun is shown again. `:by` of the facts is what shows it."
  @spec start(t(), facts(), map(), Step.moment()) :: {t(), [Step.t()]}
  def start(%{pending: %{} = pending} = failsafe, facts, now, moment) do
    if other?(pending, facts) do
      {failsafe, steps} = report(failsafe, now)
      {failsafe, more} = start(failsafe, facts, now, moment)
      {failsafe, steps ++ more}
    else
      merged = Map.merge(pending, facts, fn _key, before, now -> now || before end)
      both = Map.take(facts, [:more, :needs_action])
      merged = merged |> Map.drop([:more, :needs_action]) |> Map.merge(Map.take(both, Map.keys(pending)))
      failsafe = %{failsafe | pending: merged}
      if complete?(failsafe), do: report(failsafe, now), else: due(failsafe, moment.at, now)
    end
  end

  def start(failsafe, facts, now, %{at: at} = moment) do
    case repeated(failsafe, facts, at) do
      nil ->
        wait(failsafe, facts, now, moment)

      key ->
        shown = facts.by == :status
        active = Map.update!(failsafe.active, key, &%{&1 | last: at, shown: &1.shown or shown})
        failsafe = %{failsafe | active: active}

        # "RC Short Failsafe On" of a mission, and then "RC Long Failsafe On: switched to RTL".
        if facts.by == :text and active[key].action == "none",
          do: wait(failsafe, Map.put(facts, :needs_action, true), now, moment),
          else: {failsafe, []}
    end
  end

  defp wait(failsafe, facts, now, %{at: at} = moment) do
    failsafe = %{failsafe | pending: Map.merge(facts, %{at: at, moment: moment})}
    if complete?(failsafe), do: report(failsafe, now), else: {failsafe, []}
  end

  defp other?(%{type: type, reason: reason}, %{type: type, reason: other}),
    do: type not in [reason, other] and reason != other

  defp other?(%{type: type}, %{type: other}), do: "unknown" not in [type, other] and type != other
  defp other?(_pending, _facts), do: false

  # The active failsafe that these facts show once more.
  defp repeated(failsafe, facts, at) do
    Enum.find_value(failsafe.active, fn {{type, reason} = key, one} ->
      same =
        case facts do
          %{by: :status} ->
            at - one.since <= @reason_us

          %{by: :mode} ->
            at - one.last <= @reason_us

          %{by: :text, type: "unknown"} ->
            at - one.last <= @again_us

          %{by: :text, type: other} = f ->
            type == other and at - one.last <= @again_us and f[:reason] in [nil, type, reason]

          %{by: :fence} ->
            type == "fence"

          %{by: :report} = f ->
            {type, reason} == {f[:type], f[:reason]} and one.action == f.action
        end

      if same, do: key
    end)
  end

  defp complete?(%{pending: nil}), do: false
  defp complete?(%{pending: %{by: :report}}), do: true
  defp complete?(%{pending: %{more: true}}), do: false

  defp complete?(%{pending: pending} = failsafe),
    do: pending[:type] not in [nil, "unknown"] and action(failsafe) not in [nil, "none"]

  defp report(%{pending: nil} = failsafe, _now), do: {failsafe, []}

  defp report(%{pending: pending} = failsafe, now) do
    if is_map_key(pending, :needs_action) and action(failsafe) in [nil, "none"],
      do: {%{failsafe | pending: nil}, []},
      else: report(failsafe, pending, action(failsafe), now)
  end

  defp report(failsafe, pending, action, now) do
    {type, reason, text} = cause(failsafe, pending, now)
    key = {type, reason}
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
    do: %{moment | where: mode_change_position(failsafe.mode_change, at) || now[:where]}

  defp moment(_failsafe, moment, _now), do: moment

  defp mode_change_position({changed, _mode, where}, at) when abs(changed - at) <= @settle_us,
    do: where

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

    named = Enum.find(near, fn {type, _reason, _text} -> type != "unknown" end) |> estimator(near)

    case {named, troubles, near} do
      {nil, [trouble | _], _near} -> {trouble, trouble, nil}
      {nil, [], [{type, reason, text} | _]} -> {type, reason, text}
      {nil, [], []} -> {"unknown", "unknown", nil}
      {named, _troubles, _near} -> named
    end
  end

  # An estimator that fails without a position says so itself: it is what acts, not the receiver.
  defp estimator({type, _reason, _text} = named, near) when type in ["gps", "position"],
    do: Enum.find(near, named, fn {type, _reason, text} -> type == "ekf" and text != nil end)

  defp estimator(named, _near), do: named

  @doc "The last hint of one of these types within five seconds before `at`: `{type, reason}` or nil."
  @spec last_hint(t(), integer(), [String.t()]) :: key() | nil
  def last_hint(failsafe, at, types) do
    Enum.find_value(failsafe.hints, fn {named, type, reason, _text} ->
      if type in types and at - named <= @reason_us, do: {type, reason}
    end)
  end

  defp action(%{pending: %{action: action}}) when action != nil, do: action
  defp action(%{pending: %{found: true}}), do: nil

  # A failsafe of the fence may be shown late: FENCE_STATUS comes after the mode.
  defp action(%{pending: %{by: :fence, at: at}, mode_change: {changed, mode, _where}})
       when abs(changed - at) <= @heartbeats_us and mode in @fence_modes,
       do: word(mode)

  defp action(%{pending: %{by: :fence}}), do: "none"

  defp action(%{pending: %{at: at} = pending, mode_change: {changed, mode, _where}})
       when changed >= at - @settle_us do
    if changed <= at + wait_us(pending), do: word(mode), else: "none"
  end

  # The mode did not change.
  defp action(_failsafe), do: "none"

  defp word(mode), do: mode |> String.downcase() |> String.replace_prefix("auto_", "")

  @doc "Failsafes are over: all, those of a type, those that the system status showed, or those that it never showed."
  @spec clear(t(), :all | :shown | :unshown | {:type, String.t()}, String.t(), map(), Step.moment()) ::
          {t(), [Step.t()]}
  def clear(failsafe, which, by, now, %{at: at}) do
    {failsafe, steps} = report(failsafe, now)

    {over, active} =
      Map.split_with(failsafe.active, fn {{type, _reason}, one} ->
        which == :all or which == {:type, type} or (which == :unshown and not one.shown) or
          (which == :shown and one.shown)
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
