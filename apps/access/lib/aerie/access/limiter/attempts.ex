defmodule Aerie.Access.Limiter.Attempts do
  @moduledoc """
  Attempts to sign in, and which is to be refused or delayed. Pure; all within a minute.

  | counted for | limit | beyond it |
  |---|---|---|
  | an address and an account together | 5 | this address waits for this account |
  | an address | 20 | this address waits |
  | an account, wrong passwords from addresses that are not known | 10 | attempts from such addresses take up to 3 s longer |

  An address is known if somebody signed in from it lately, or if it is this machine. So no attacker can lock others out: wrong
  passwords lock only the address that sends them, and from many addresses they make signing in from a new one slower, never impossible. The
  printed address is not counted at all: its token cannot be guessed.

  Addresses of IPv6 count by their first 64 bits, which one host has to itself.
  """

  @window_ms 60_000
  @pair 5
  @address 20
  @free 10
  @step_ms 100
  @longest_ms 3_000
  # Entries of each table; beyond it others are dropped.
  @most 4_096
  @known 256

  defstruct pairs: %{}, addresses: %{}, accounts: %{}, known: []

  @type t :: %__MODULE__{}
  @typedoc "`place/1` of an address."
  @type place :: tuple()

  @doc "The place that an address counts as: IPv4 as it is, a network of IPv6."
  @spec place(:inet.ip_address()) :: place()
  def place({0, 0, 0, 0, 0, 0xFFFF, high, low}),
    do: {div(high, 256), rem(high, 256), div(low, 256), rem(low, 256)}

  def place({0, 0, 0, 0, 0, 0, 0, 1}), do: {127, 0, 0, 1}
  def place({a, b, c, d, _e, _f, _g, _h}), do: {a, b, c, d, :v6}
  def place({127, _b, _c, _d}), do: {127, 0, 0, 1}
  def place(address), do: address

  @doc "Counts an attempt: go on after so many milliseconds, or wait for so many seconds."
  @spec try(t(), place(), account :: term(), now :: integer()) ::
          {:ok, delay_ms :: non_neg_integer(), t()} | {:wait, pos_integer()}
  def try(attempts, place, account, now) do
    pair = recent(attempts.pairs, {place, account}, now)
    address = recent(attempts.addresses, place, now)

    case max(full(pair, @pair, now), full(address, @address, now)) do
      0 ->
        wrong = attempts.accounts |> recent(account, now) |> length()
        delay = if known?(attempts, place), do: 0, else: min(max(wrong - @free, 0) * @step_ms, @longest_ms)

        {:ok, delay,
         %{
           attempts
           | pairs: put(attempts.pairs, {place, account}, [now | pair], now),
             addresses: put(attempts.addresses, place, [now | address], now)
         }}

      seconds ->
        {:wait, seconds}
    end
  end

  @doc "Records the outcome of an attempt. `:none`: the password was not checked."
  @spec outcome(t(), place(), account :: term(), :right | :wrong | :none, now :: integer()) :: t()
  def outcome(attempts, place, account, :right, _now) do
    %{
      attempts
      | pairs: Map.delete(attempts.pairs, {place, account}),
        addresses: Map.delete(attempts.addresses, place),
        known: Enum.take([place | List.delete(attempts.known, place)], @known)
    }
  end

  def outcome(attempts, place, account, :wrong, now) do
    if known?(attempts, place) do
      attempts
    else
      # More than these delay no longer.
      times = attempts.accounts |> recent(account, now) |> Enum.take(@free + div(@longest_ms, @step_ms))
      %{attempts | accounts: put(attempts.accounts, account, [now | times], now)}
    end
  end

  def outcome(attempts, place, account, :none, now) do
    pair = attempts.pairs |> recent({place, account}, now) |> Enum.drop(1)
    address = attempts.addresses |> recent(place, now) |> Enum.drop(1)

    %{
      attempts
      | pairs: put(attempts.pairs, {place, account}, pair, now),
        addresses: put(attempts.addresses, place, address, now)
    }
  end

  @doc "Whether somebody signed in from there lately, or it is this machine."
  @spec known?(t(), place()) :: boolean()
  def known?(_attempts, {127, 0, 0, 1}), do: true
  def known?(attempts, place), do: place in attempts.known

  # Newest first.
  defp recent(table, key, now), do: table |> Map.get(key, []) |> Enum.take_while(&(now - &1 < @window_ms))

  defp put(table, key, [], _now), do: Map.delete(table, key)

  defp put(table, key, times, now) do
    table = if map_size(table) < @most or is_map_key(table, key), do: table, else: room(table, now)
    Map.put(table, key, times)
  end

  # A quarter at once, so that a flood from ever new addresses sorts the table seldom.
  defp room(table, now) do
    case Map.reject(table, fn {_key, [newest | _older]} -> now - newest >= @window_ms end) do
      full when map_size(full) >= @most ->
        full
        |> Enum.sort_by(fn {_key, [newest | _older]} -> newest end, :desc)
        |> Enum.take(div(@most * 3, 4))
        |> Map.new()

      left ->
        left
    end
  end

  # Seconds until another attempt is allowed.
  defp full(times, most, now) do
    case Enum.at(times, most - 1) do
      nil -> 0
      at -> div(@window_ms - (now - at) + 999, 1000)
    end
  end
end
