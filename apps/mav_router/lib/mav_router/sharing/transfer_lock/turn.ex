defmodule MavRouter.Sharing.TransferLock.Turn do
  @silent_ms 5_000
  # PX4 and ArduPilot give up after 5 and 8 s without an item; QGroundControl repeats after 1.5 s, MAVSDK after 0.5 s.
  @once_ms 10_000

  @moduledoc """
  The owner of a transfer with a vehicle, and the waiting ones: a pure state machine, one for each vehicle and kind of transfer.

  The first to begin has the turn until its transfer has ended, or until neither it nor the vehicle has said anything of it for
  #{@silent_ms} ms. Others wait with the frame by which they begin; a repetition takes the place of the frame before it. They get
  the turn in the order in which they came, unless they have given up: they repeated their request and stopped doing so, or they
  asked once and #{@once_ms} ms went by. A transfer that begins when nobody wants it any more would only block the vehicle.

  A frame that continues a transfer out of turn is refused: it would disturb the transfer whose turn it is.

  The gateway's own transfers take part by `take/4` and `give_back/2`. Their frames do not pass here, so neither silence nor an answer
  ends such a turn, and one that waits does not time out.
  """

  @grace_ms 500
  @max_waiting 16

  defstruct [:who, :at, open: [], waiting: []]

  @typedoc "The asker: any term, and its ids; the gateway itself by one of its processes"
  @type who :: {term, system :: non_neg_integer, component :: 0..255} | {:gateway, pid}
  @typedoc "What is released later: any term"
  @type item :: term
  @type waiting :: %{who: who, item: item, part: 0..255, first: integer, last: integer, gap: integer | nil}
  @type t :: %__MODULE__{who: who | nil, at: integer | nil, open: [0..255], waiting: [waiting]}

  @doc "No transfer has the turn."
  @spec new() :: t
  def new, do: %__MODULE__{}

  @doc "Whether nobody has the turn and nobody waits."
  @spec idle?(t) :: boolean
  def idle?(%__MODULE__{who: who, waiting: waiting}), do: who == nil and waiting == []

  @doc """
  A step of a transfer is on its way to the vehicle (monotonic ms): `:go`, it is its turn; `:hold`, `item` waits, or took the
  place of the sender's former one; `:refuse`.
  """
  @spec ask(t, who, :begin | :more | :end, 0..255, item, integer) :: {:go | :hold | :refuse, t}
  def ask(%__MODULE__{who: who} = turn, who, step, part, _item, now),
    do: {:go, turn |> step(step, part) |> at(now)}

  def ask(%__MODULE__{who: nil, waiting: []} = turn, _who, :end, _part, _item, _now), do: {:go, turn}

  def ask(%__MODULE__{who: nil, waiting: []} = turn, who, _step, part, _item, now),
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

  @doc "The vehicle sends a step of a transfer to these ids (0: all)."
  @spec answered(t, {non_neg_integer, 0..255}, :begin | :more | :end, 0..255, integer) :: t
  def answered(%__MODULE__{who: {_key, system, component}} = turn, {to, to_component}, step, part, now)
      when to in [0, system] and to_component in [0, component],
      do: turn |> step(step, part) |> at(now)

  def answered(turn, _to, _step, _part, _now), do: turn

  @doc """
  A transfer of the gateway begins: `:go`, it has the turn until it gives it back; `:hold`, it waits its turn with `item`. It is asked
  once, and is let in however many wait: there is one such process for each vehicle.
  """
  @spec take(t, who, item, integer) :: {:go | :hold, t}
  def take(%__MODULE__{who: nil, waiting: []} = turn, {:gateway, _pid} = who, _item, now),
    do: {:go, %{turn | who: who, open: [0], at: now}}

  def take(turn, {:gateway, _pid} = who, item, now) do
    one = %{who: who, item: item, part: 0, first: now, last: now, gap: nil}
    {:hold, %{turn | waiting: turn.waiting ++ [one]}}
  end

  @doc "A transfer of the gateway has ended, or does not wait any more."
  @spec give_back(t, who) :: t
  def give_back(%__MODULE__{who: who} = turn, who), do: %{turn | who: nil, open: [], at: nil}
  def give_back(turn, who), do: %{turn | waiting: Enum.reject(turn.waiting, &(&1.who == who))}

  defp step(turn, :begin, part), do: %{turn | open: [part | List.delete(turn.open, part)]}
  defp step(turn, :more, _part), do: turn

  defp step(turn, :end, part) do
    case List.delete(turn.open, part) do
      [] -> %{turn | who: nil, open: []}
      open -> %{turn | open: open}
    end
  end

  defp at(%{who: nil} = turn, _now), do: %{turn | at: nil}
  defp at(turn, now), do: %{turn | at: now}

  @doc """
  Ends a turn that has been silent, forgets those who gave up, and gives the turn to the one that waits longest. Gives what is
  let go now (one item at most), the items of those who gave up, and the turn.
  """
  @spec next(t, integer) :: {[item], gave_up :: [item], t}
  def next(turn, now) do
    {waiting, gone} = Enum.split_with(turn.waiting, &waits?(&1, now))
    gave_up = Enum.map(gone, & &1.item)
    turn = turn |> silent(now) |> Map.put(:waiting, waiting)

    case turn do
      %{who: nil, waiting: [one | rest]} ->
        {[one.item], gave_up, %{turn | who: one.who, open: [one.part], at: now, waiting: rest}}

      _taken_or_nobody ->
        {[], gave_up, turn}
    end
  end

  defp silent(%{who: {:gateway, _pid}} = turn, _now), do: turn

  defp silent(%{at: at} = turn, now) when at != nil and now - at >= @silent_ms,
    do: %{turn | who: nil, open: [], at: nil}

  defp silent(turn, _now), do: turn

  defp waits?(%{who: {:gateway, _pid}}, _now), do: true
  defp waits?(%{gap: nil, first: first}, now), do: now - first < @once_ms
  defp waits?(%{gap: gap, last: last}, now), do: now - last <= min(gap + @grace_ms, @once_ms)
end
