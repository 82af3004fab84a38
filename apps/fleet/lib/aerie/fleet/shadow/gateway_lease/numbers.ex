defmodule Aerie.Fleet.Shadow.GatewayLease.Numbers do
  @moduledoc """
  Tells new words about leases from old ones that somebody sends again. A pure value.

  Each lease and each gateway's sign of life has a number that grows, so what was seen before, or is older, counts for
  nothing. After a start nothing was seen yet. Then a gateway is believed for three times `ttl_ms`, and longer
  only if its sign of life names a recent number of ours, which nobody could have recorded before. Clocks need
  not agree.

  Times are milliseconds.
  """

  alias Aerie.Fleet.Shadow.Store.LeaseSeal

  @max 4_096
  # What fits into a sign of life beside its name.
  @echoes 16
  @echo_bytes 600

  @enforce_keys [:me, :ttl_ms]
  defstruct [:me, :ttl_ms, sent: [], last: %{}, first: %{}, proved: MapSet.new(), turn: 0]

  @typedoc """
    * `:sent` - numbers of our own signs of life, with their times
    * `:last` - the last number of each lease and each gateway
    * `:first` - when each gateway was seen first
    * `:proved` - gateways that named a number of ours
  """
  @type t :: %__MODULE__{
          me: String.t(),
          ttl_ms: pos_integer(),
          sent: [{pos_integer(), integer()}],
          last: %{LeaseSeal.subject() => pos_integer()},
          first: %{String.t() => integer()},
          proved: MapSet.t(String.t()),
          turn: non_neg_integer()
        }

  @spec new(me :: String.t(), ttl_ms :: pos_integer()) :: t()
  def new(me, ttl_ms), do: %__MODULE__{me: me, ttl_ms: ttl_ms}

  @doc "The number for what this gateway writes next, by the wall clock unless that was behind."
  @spec next(t(), LeaseSeal.subject(), wall :: integer()) :: {pos_integer(), t()}
  def next(numbers, subject, wall) do
    number = max(Map.get(numbers.last, subject, 0) + 1, wall)
    {number, put(numbers, subject, number)}
  end

  @doc "A sign of life of ours with this number is on its way."
  @spec sent(t(), pos_integer(), now :: integer()) :: t()
  def sent(numbers, number, now), do: %{numbers | sent: [{number, now} | recent(numbers, now)]}

  defp recent(numbers, now),
    do: Enum.filter(numbers.sent, fn {_number, at} -> now - at <= div(numbers.ttl_ms * 3, 2) end)

  @doc "What a number says about a sealed word: it is newer than all before, the last one once more, or older."
  @spec seen(t(), LeaseSeal.subject(), pos_integer()) :: {:new | :same | :old, t()}
  def seen(numbers, subject, number) do
    case numbers.last do
      %{^subject => ^number} -> {:same, numbers}
      %{^subject => later} when later > number -> {:old, numbers}
      _earlier_or_none -> {:new, put(numbers, subject, number)}
    end
  end

  # All are from gateways with our key. With so many the memory begins again.
  defp put(numbers, subject, number) do
    last = if map_size(numbers.last) >= @max, do: %{}, else: numbers.last
    %{numbers | last: Map.put(last, subject, number)}
  end

  @doc "Whether a new sign of life proves that its gateway lives; `echo` is the number of ours that it names."
  @spec alive(t(), id :: String.t(), echo :: term(), now :: integer()) :: {boolean(), t()}
  def alive(numbers, id, echo, now) do
    first = if map_size(numbers.first) >= @max, do: %{}, else: numbers.first
    numbers = %{numbers | first: Map.put_new(first, id, now)}
    mine = {:gateway, numbers.me}

    cond do
      List.keymember?(recent(numbers, now), echo, 0) ->
        {true, %{numbers | proved: MapSet.put(numbers.proved, id)}}

      # Our clock was set back: the others would take what we say for old.
      is_integer(echo) and echo > Map.get(numbers.last, mine, 0) ->
        {believed?(numbers, id, now), put(numbers, mine, echo)}

      true ->
        {believed?(numbers, id, now), numbers}
    end
  end

  defp believed?(numbers, id, now),
    do: MapSet.member?(numbers.proved, id) or now - Map.fetch!(numbers.first, id) <= 3 * numbers.ttl_ms

  @doc "The last numbers of other gateways, for our sign of life: those that there is room for, in turn."
  @spec echo(t()) :: {%{String.t() => pos_integer()}, t()}
  def echo(numbers) do
    others = for {{:gateway, id}, number} <- Enum.sort(numbers.last), id != numbers.me, do: {id, number}
    turn = if numbers.turn < length(others), do: numbers.turn, else: 0
    echoed = others |> Enum.drop(turn) |> Enum.take(@echoes) |> fitting()
    {Map.new(echoed), %{numbers | turn: turn + max(length(echoed), 1)}}
  end

  defp fitting(others) do
    {fitting, _bytes} =
      Enum.flat_map_reduce(others, 0, fn {id, number}, bytes ->
        bytes = bytes + byte_size(id) + 20
        if bytes <= @echo_bytes, do: {[{id, number}], bytes}, else: {:halt, bytes}
      end)

    fitting
  end

  @doc "Nothing was seen for a while; others may have recorded what was said, so each proves itself again."
  @spec gap(t()) :: t()
  def gap(numbers), do: %{numbers | first: %{}, proved: MapSet.new()}
end
