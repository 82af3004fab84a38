defmodule Aerie.Vehicle.Detector.Failsafe do
  @moduledoc """
  Failsafes: when one begins, why, what the vehicle does about it, and when it is over. A part of the detector.

  One begins with whatever shows it first: the system status of the heartbeat, a text, a report (EVENT), a mode that only the
  vehicle itself chooses. What shows it rarely says all: ArduPilot's heartbeat comes milliseconds before the text that says
  why, and a text before the change of the mode. So one is open for a second (`pending`), takes up what is said meanwhile,
  and is given with the time of its first sign as soon as cause and action are known, or when the second is over.

  Several can be on at once (`active`), each with its type and reason; the system status shows them together. One is
  over when a text or report says so, when the system status is well again, or, where that never showed it, when the
  vehicle is disarmed.
  """

  alias Aerie.Vehicle.Detector

  # For how long what begins a failsafe waits for what explains it, and how far back a change of the mode belongs to it.
  @settle_us 1_000_000
  # A reason that was named longer ago than this is not why a failsafe came.
  @reason_us 5_000_000
  # The same failsafe said in another way.
  @again_us 3_000_000
  @max_said 8
  @max_active 16
  # Only the vehicle itself goes there.
  @forced %{"AUTO_DESCEND" => "descend", "TERMINATION" => "terminate", "AVOID_ADSB" => "avoid_adsb"}

  defstruct pending: nil, active: %{}, said: [], moved: nil

  @typedoc "What is known of one: `:type`, `:reason`, `:action`, `:delay`, `:text`, `:report`, `:found`."
  @type facts :: %{optional(atom()) => term()}
  @type key :: {type :: String.t(), reason :: String.t()}
  @type t :: %__MODULE__{
          pending: map() | nil,
          active: %{key() => %{since: integer(), last: integer(), shown: boolean(), action: term()}},
          said: [{integer(), String.t(), String.t(), String.t() | nil}],
          moved: {integer(), mode :: String.t(), where :: map() | nil} | nil
        }
  @type step :: Detector.step()

  @doc "For how long an open failsafe may wait for its cause (us)."
  @spec settle_us() :: pos_integer()
  def settle_us, do: @settle_us

  @doc "Something said, with its time, what might be the cause of a failsafe: type, reason, and the text if it was one."
  @spec said(t(), integer(), String.t(), String.t(), String.t() | nil) :: t()
  def said(failsafe, at, type, reason, text \\ nil),
    do: %{failsafe | said: Enum.take([{at, type, reason, text} | failsafe.said], @max_said)}

  @doc "It is `at`: one that waited long enough is given."
  @spec due(t(), integer(), map()) :: {t(), [step()]}
  def due(%{pending: %{at: since}} = failsafe, at, now) when at >= since + @settle_us or at < since,
    do: give(failsafe, now)

  def due(failsafe, _at, _now), do: {failsafe, []}

  @doc "The difference of two digests."
  @spec changed(t(), map(), map(), Detector.moment()) :: {t(), [step()]}
  def changed(failsafe, last, now, moment) do
    Enum.reduce([&status/4, &moved/4, &disarmed/4], {failsafe, []}, fn part, {failsafe, steps} ->
      {failsafe, more} = part.(failsafe, last, now, moment)
      {failsafe, steps ++ more}
    end)
  end

  defp moved(failsafe, %{mode: from}, %{mode: to} = now, {at, _, _} = moment) when from != to do
    failsafe = %{failsafe | moved: {at, to, elem(moment, 2)}}

    case @forced do
      %{^to => action} -> begins(failsafe, %{by: :mode, action: action}, now, moment)
      _any -> if complete?(failsafe), do: give(failsafe, now), else: {failsafe, []}
    end
  end

  defp moved(failsafe, _last, _now, _moment), do: {failsafe, []}

  defp status(failsafe, last, %{failsafe: true} = now, moment) when not is_map_key(last, :failsafe),
    do: begins(failsafe, %{by: :status, found: true}, now, moment)

  defp status(failsafe, %{failsafe: false}, %{failsafe: true} = now, moment),
    do: begins(failsafe, %{by: :status}, now, moment)

  defp status(failsafe, %{failsafe: true}, %{failsafe: false} = now, moment),
    do: cleared(failsafe, :all, "status", now, moment)

  defp status(failsafe, _last, _now, _moment), do: {failsafe, []}

  defp disarmed(failsafe, %{armed: true}, %{armed: false} = now, moment),
    do: cleared(failsafe, :unshown, "disarmed", now, moment)

  defp disarmed(failsafe, _last, _now, _moment), do: {failsafe, []}

  @doc "One begins, or what began is said again. `:by` of the facts is what shows it."
  @spec begins(t(), facts(), map(), Detector.moment()) :: {t(), [step()]}
  def begins(%{pending: %{} = pending} = failsafe, facts, now, moment) do
    if other?(pending, facts) do
      {failsafe, steps} = give(failsafe, now)
      {failsafe, more} = begins(failsafe, facts, now, moment)
      {failsafe, steps ++ more}
    else
      told = %{failsafe | pending: Map.merge(pending, facts, fn _key, before, now -> now || before end)}
      if complete?(told), do: give(told, now), else: {told, []}
    end
  end

  def begins(failsafe, facts, now, {at, _, _} = moment) do
    case again(failsafe, facts, at) do
      nil ->
        began = %{failsafe | pending: Map.merge(facts, %{at: at, moment: moment})}
        if complete?(began), do: give(began, now), else: {began, []}

      key ->
        shown = facts.by == :status
        active = Map.update!(failsafe.active, key, &%{&1 | last: at, shown: &1.shown or shown})
        {%{failsafe | active: active}, []}
    end
  end

  defp other?(%{type: type}, %{type: other}), do: "unknown" not in [type, other] and type != other
  defp other?(_pending, _facts), do: false

  # The one of those that are on that this says once more.
  defp again(failsafe, facts, at) do
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

  defp give(%{pending: nil} = failsafe, _now), do: {failsafe, []}

  defp give(%{pending: pending} = failsafe, now) do
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

    {%{failsafe | pending: nil, active: Map.put(active, key, one)},
     [{"failsafe", data, [], moment(failsafe, pending.moment, now)}]}
  end

  # A text does not say where; what was seen within the second does.
  defp moment(failsafe, {at, boot_ms, nil}, now) do
    moved =
      if match?({moved, _, _} when abs(moved - at) <= @settle_us, failsafe.moved), do: elem(failsafe.moved, 2)

    {at, boot_ms, now[:where] || moved}
  end

  defp moment(_failsafe, moment, _now), do: moment

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
    Enum.find_value(failsafe.said, type, fn {at, of, reason, _text} ->
      if of == type and reason != type and abs(at - pending.at) <= @settle_us, do: reason
    end)
  end

  defp precisely(_failsafe, _type, reason, _pending), do: reason

  # "Battery 1 is critical 9.80V" and "Battery Failsafe" belong together.
  defp texts(failsafe, type, pending) do
    before =
      for {at, ^type, _, text} <- failsafe.said, text != nil, abs(at - pending.at) <= @settle_us, do: text

    case Enum.uniq(Enum.reverse(before) ++ List.wrap(pending[:text])) do
      [] -> nil
      texts -> Enum.join(texts, "; ")
    end
  end

  @doc """
  Why one that begins `at` came, as far as it was said within five seconds before; else by what is wrong with the vehicle
  just now.
  """
  @spec why(t(), integer(), [String.t()]) ::
          {type :: String.t(), reason :: String.t(), text :: String.t() | nil}
  def why(failsafe, at, troubles) do
    near = for {said, type, reason, text} <- failsafe.said, at - said <= @reason_us, do: {type, reason, text}
    named = Enum.find(near, fn {type, _reason, _text} -> type != "unknown" end)

    case {named, troubles, near} do
      {nil, [trouble | _], _near} -> {trouble, trouble, nil}
      {nil, [], [{type, reason, text} | _]} -> {type, reason, text}
      {nil, [], []} -> {"unknown", "unknown", nil}
      {named, _troubles, _near} -> named
    end
  end

  @doc "Which of some types was said last, within five seconds before `at`: `{type, reason}` or nil."
  @spec last_said(t(), integer(), [String.t()]) :: key() | nil
  def last_said(failsafe, at, types) do
    Enum.find_value(failsafe.said, fn {said, type, reason, _text} ->
      if type in types and at - said <= @reason_us, do: {type, reason}
    end)
  end

  defp action(%{pending: %{action: action}}) when action != nil, do: action
  defp action(%{pending: %{found: true}}), do: nil

  defp action(%{pending: %{at: at}, moved: {moved, mode, _where}}) when abs(moved - at) <= @settle_us,
    do: mode |> String.downcase() |> String.replace_prefix("auto_", "")

  # The mode stayed as it was.
  defp action(_failsafe), do: "none"

  @doc "Failsafes are over: all, those of a type, or those that the system status never showed."
  @spec cleared(t(), :all | :unshown | {:type, String.t()}, String.t(), map(), Detector.moment()) ::
          {t(), [step()]}
  def cleared(failsafe, which, by, now, {at, _, _}) do
    {failsafe, steps} = give(failsafe, now)

    {over, active} =
      Map.split_with(failsafe.active, fn {{type, _reason}, one} ->
        which == :all or which == {:type, type} or (which == :unshown and not one.shown)
      end)

    ends =
      for {{type, reason}, one} <- Enum.sort_by(over, fn {key, one} -> {one.since, key} end) do
        duration = Float.round(max(at - one.since, 0) / 1_000_000, 1)

        {"failsafe.cleared", %{"type" => type, "reason" => reason, "duration" => duration, "by" => by}, []}
      end

    {%{failsafe | active: active}, steps ++ ends}
  end
end
