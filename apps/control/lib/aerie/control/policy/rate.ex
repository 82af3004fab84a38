defmodule Aerie.Control.Policy.Rate do
  @moduledoc """
  How often each source may give each vehicle each type of command: token buckets as data. A value of its own beside the
  policy, so that reloading the policy does not reset rate limits.

  Every rule that names a command has a bucket of it for each source, vehicle and type; all of them must have a token. The
  number of buckets is bounded: full ones are dropped first, and while there is no room for another one, commands that would
  need it are refused. Each source has room of its own, which no other one can take.
  """

  alias Aerie.Vehicle.Command.Types
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Mavlink.Wording
  alias Aerie.Base.Timing.TokenBucket

  # Set-points and sticks come many times a second, and a transfer as fast as the vehicle asks for its parts.
  @streams for(%{group: :manual, name: name} <- Types.all(), do: name) ++ Intent.transfers()

  @max_buckets 20_000
  # A source has so many while there is room, and so many are kept for it beyond that, up to a limit for all.
  @max_each 4_000
  @reserved 500
  @limit 2 * @max_buckets

  defstruct buckets: %{}

  @type t :: %__MODULE__{buckets: %{term() => TokenBucket.t()}}

  @typedoc "`interval_us`: a token is added so often; `burst`: so many are there at most. `:all` names every one."
  @type rule :: %{
          types: [String.t()] | :all,
          sources: [String.t()] | :all,
          vehicles: [String.t()] | :all,
          interval_us: pos_integer(),
          burst: pos_integer()
        }

  @doc "Nobody has commanded anything yet."
  @spec new() :: t()
  def new, do: %__MODULE__{}

  @doc """
  Takes a token for a command at `now` (microseconds of a clock that is never set), or says when there will be one. A refused
  command takes none.
  """
  @spec take(
          t(),
          Policy.t(),
          source :: String.t(),
          vehicle :: String.t(),
          type :: String.t(),
          now :: integer()
        ) ::
          {:ok, t()} | {:deny, :rate, String.t()}
  def take(rate, policy, source, vehicle, type, now) do
    policy
    |> rules(source, vehicle, type)
    |> Enum.reduce_while({:ok, rate.buckets}, fn {key, rule}, {:ok, buckets} ->
      case TokenBucket.take(buckets[key], now, rule.interval_us, rule.burst) do
        {:ok, full} -> {:cont, {:ok, Map.put(buckets, key, full)}}
        :none -> {:halt, {:deny, :rate, text(rule, source, vehicle, type, wait(buckets[key], rule, now))}}
      end
    end)
    |> room(rate, source, now)
  end

  @doc "Puts back the token that `take/6` took for a command which turned out to be a repetition."
  @spec put_back(t(), Policy.t(), source :: String.t(), vehicle :: String.t(), type :: String.t()) :: t()
  def put_back(rate, policy, source, vehicle, type) do
    policy
    |> rules(source, vehicle, type)
    |> Enum.reduce(rate, fn {key, rule}, rate ->
      %{rate | buckets: Map.replace_lazy(rate.buckets, key, &(&1 - rule.interval_us))}
    end)
  end

  # The rules that name a command, each with the key of its bucket.
  defp rules(policy, source, vehicle, type) do
    for rule <- policy.rates,
        types?(rule.types, type) and names?(rule.sources, source) and names?(rule.vehicles, vehicle),
        do: {{source, vehicle, type, rule.interval_us, rule.burst}, rule}
  end

  @doc "The refusal where there is no room for another bucket of a source."
  @spec full(source :: String.t()) :: {:deny, :rate, String.t()}
  def full(source),
    do: {:deny, :rate, "#{source} commanded too many vehicles just now to be counted; try again in a moment"}

  @doc "When all buckets are full again: until then a rate is worth keeping. `now` without any."
  @spec full_at(t(), now :: integer()) :: integer()
  def full_at(rate, now), do: rate.buckets |> Map.values() |> Enum.max(fn -> now end)

  defp types?(:all, type), do: type not in @streams
  defp types?(types, type), do: type in types

  defp names?(:all, _name), do: true
  defp names?(names, name), do: name in names

  defp room({:ok, buckets}, rate, source, now)
       when map_size(buckets) > @max_each and map_size(buckets) > map_size(rate.buckets) do
    if room?(buckets, source) do
      {:ok, %{rate | buckets: buckets}}
    else
      used = Map.filter(buckets, fn {_key, full} -> full > now end)

      if room?(used, source),
        do: {:ok, %{rate | buckets: used}},
        else: full(source)
    end
  end

  defp room({:ok, buckets}, rate, _source, _now), do: {:ok, %{rate | buckets: buckets}}
  defp room(deny, _rate, _source, _now), do: deny

  defp room?(buckets, source) do
    own = Enum.count(buckets, fn {key, _full} -> elem(key, 0) == source end)
    size = map_size(buckets)
    size <= @limit and own <= if(size > @max_buckets, do: @reserved, else: @max_each)
  end

  defp wait(full, rule, now), do: full + rule.interval_us - now - rule.burst * rule.interval_us

  defp text(rule, source, vehicle, type, wait_us) do
    per_minute = Float.round(60_000_000 / rule.interval_us, 1)

    "#{source} may command #{named(type)} of #{vehicle} #{whole(per_minute)} times a minute, #{rule.burst} at once; the next one is " <>
      "allowed in #{whole(Float.ceil(wait_us / 1_000_000, 1))} s"
  end

  # A command without a name in the table has that of its MAV_CMD.
  defp named("mav_cmd_" <> number), do: number |> String.to_integer() |> Wording.command()
  defp named(type), do: type

  defp whole(number), do: number |> Aerie.Base.Json.encode!() |> String.replace_suffix(".0", "")
end
