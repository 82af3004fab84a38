defmodule Aerie.Router.Turns.Turn do
  @moduledoc """
  Who has a transfer with a vehicle just now, and who waits for it: a pure state machine, one for each vehicle and kind of
  transfer.

  The first who begins has the turn, until what it began has ended, or until neither it nor the vehicle said anything of it
  for #{5_000} ms. Others wait with the frame by which they begin; a repetition takes the place of the frame before it. Who
  waits is let go in the order of coming, unless it has given up: it repeated its request and stopped doing so, or it asked once
  and #{10_000} ms went by. A begin that nobody stands behind any more would only block the vehicle.

  Who goes on with a transfer that is another's turn by now is refused; its frames would fall into that one.
  """

  @silent_ms 5_000
  # PX4 and ArduPilot give up after 5 and 8 s without an item; QGroundControl repeats after 1.5 s, MAVSDK after 0.5 s.
  @once_ms 10_000
  @grace_ms 500
  @max_waiting 16

  defstruct [:who, :at, open: [], waiting: []]

  @typedoc "Who asks: any term, and its ids"
  @type who :: {term, system :: non_neg_integer, component :: 0..255}
  @typedoc "What is let go later: any term"
  @type item :: term
  @type waiting :: %{who: who, item: item, part: 0..255, first: integer, last: integer, gap: integer | nil}
  @type t :: %__MODULE__{who: who | nil, at: integer | nil, open: [0..255], waiting: [waiting]}

  @doc "Nobody's turn."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "Whether it is nobody's turn and nobody waits."
  @spec idle?(t) :: boolean
  def idle?(%__MODULE__{who: who, waiting: waiting}), do: who == nil and waiting == []

  @doc """
  Somebody says a part of a transfer to the vehicle, at monotonic ms: `:go`, it is its turn; `:hold`, `item` waits, or took
  the place of its former one; `:refuse`.
  """
  @spec ask(t, who, :begin | :more | :end, 0..255, item, integer) :: {:go | :hold | :refuse, t}
  def ask(%__MODULE__{who: who} = turn, who, said, part, _item, now),
    do: {:go, turn |> said(said, part) |> at(now)}

  def ask(%__MODULE__{who: nil, waiting: []} = turn, _who, :end, _part, _item, _now), do: {:go, turn}

  def ask(%__MODULE__{who: nil, waiting: []} = turn, who, _said, part, _item, now),
    do: {:go, %{turn | who: who, open: [part], at: now}}

  def ask(turn, who, :begin, part, item, now) do
    case Enum.split_while(turn.waiting, &(&1.who != who)) do
      {before, [one | rest]} ->
        one = %{one | item: item, part: part, last: now, gap: max(now - one.last, 1)}
        {:hold, %{turn | waiting: before ++ [one | rest]}}

      {all, []} when length(all) < @max_waiting ->
        one = %{who: who, item: item, part: part, first: now, last: now, gap: nil}
        {:hold, %{turn | waiting: all ++ [one]}}

      _full ->
        {:refuse, turn}
    end
  end

  def ask(turn, _who, _more_or_end, _part, _item, _now), do: {:refuse, turn}

  @doc "The vehicle says a part of a transfer to somebody with these ids (0: all)."
  @spec heard(t, {non_neg_integer, 0..255}, :begin | :more | :end, 0..255, integer) :: t
  def heard(%__MODULE__{who: {_key, system, component}} = turn, {to, to_component}, said, part, now)
      when to in [0, system] and to_component in [0, component],
      do: turn |> said(said, part) |> at(now)

  def heard(turn, _to, _said, _part, _now), do: turn

  defp said(turn, :begin, part), do: %{turn | open: [part | List.delete(turn.open, part)]}
  defp said(turn, :more, _part), do: turn

  defp said(turn, :end, part) do
    case List.delete(turn.open, part) do
      [] -> %{turn | who: nil, open: []}
      open -> %{turn | open: open}
    end
  end

  defp at(%{who: nil} = turn, _now), do: %{turn | at: nil}
  defp at(turn, now), do: %{turn | at: now}

  @doc """
  Ends a turn of silence, forgets who gave up, and gives the turn to who waits longest: what is to be let go now (one item at
  most), what of those who gave up, and the turn.
  """
  @spec next(t, integer) :: {[item], gave_up :: [item], t}
  def next(turn, now) do
    {waiting, gone} = Enum.split_with(turn.waiting, &stands?(&1, now))
    gave_up = Enum.map(gone, & &1.item)
    turn = turn |> silent(now) |> Map.put(:waiting, waiting)

    case turn do
      %{who: nil, waiting: [one | rest]} ->
        {[one.item], gave_up, %{turn | who: one.who, open: [one.part], at: now, waiting: rest}}

      _taken_or_nobody ->
        {[], gave_up, turn}
    end
  end

  defp silent(%{at: at} = turn, now) when at != nil and now - at >= @silent_ms,
    do: %{turn | who: nil, open: [], at: nil}

  defp silent(turn, _now), do: turn

  defp stands?(%{gap: nil, first: first}, now), do: now - first < @once_ms
  defp stands?(%{gap: gap, last: last}, now), do: now - last <= min(gap + @grace_ms, @once_ms)
end
