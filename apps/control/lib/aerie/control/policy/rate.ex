defmodule Aerie.Control.Policy.Rate do
  @moduledoc """
  How often a source may give a vehicle each type of command: token buckets as data. A value of its own beside the
  policy, so that reloading the policy does not reset rate limits. `Aerie.Control.Policy.Rate.Table` has those of all
  sources and vehicles.

  Every rule that names a command has a bucket of it for each type; all of them must have a token. Full buckets are
  dropped when there are too many; while there is no room for another one, commands that would need it are refused.
  """

  alias Aerie.Vehicle.Command.{Refusal, Types}
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Intent
  alias Aerie.Control.Policy.Mavlink.Wording
  alias Aerie.Base.Timing.TokenBucket

  # Set-points and sticks come many times a second, and a transfer as fast as the vehicle asks for its parts.
  @streams for(%{group: :manual, name: name} <- Types.all(), do: name) ++ Intent.transfers()

  # More than there are types of commands; those of raw MAVLink have numbers.
  @max 1_000

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
          {:ok, t()} | Refusal.denial()
  def take(rate, policy, source, vehicle, type, now) do
    policy
    |> rules(source, vehicle, type)
    |> Enum.reduce_while({:ok, rate.buckets}, fn {key, rule}, {:ok, buckets} ->
      case TokenBucket.take(buckets[key], now, rule.interval_us, rule.burst) do
        {:ok, full} -> {:cont, {:ok, Map.put(buckets, key, full)}}
        :none -> {:halt, refused(rule, source, vehicle, type, wait(buckets[key], rule, now))}
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
        do: {{type, rule.interval_us, rule.burst}, rule}
  end

  @doc "The refusal where there is no room for another bucket of a source."
  @spec full(source :: String.t()) :: Refusal.denial()
  def full(source), do: Refusal.deny(:rate_uncounted, source: source)

  @doc "When all buckets are full again: until then a rate is worth keeping. `now` without any."
  @spec full_at(t(), now :: integer()) :: integer()
  def full_at(rate, now), do: rate.buckets |> Map.values() |> Enum.max(fn -> now end)

  defp types?(:all, type), do: type not in @streams
  defp types?(types, type), do: type in types

  defp names?(:all, _name), do: true
  defp names?(names, name), do: name in names

  defp room({:ok, buckets}, rate, source, now)
       when map_size(buckets) > @max and map_size(buckets) > map_size(rate.buckets) do
    used = Map.filter(buckets, fn {_key, full} -> full > now end)
    if map_size(used) <= @max, do: {:ok, %{rate | buckets: used}}, else: full(source)
  end

  defp room({:ok, buckets}, rate, _source, _now), do: {:ok, %{rate | buckets: buckets}}
  defp room(deny, _rate, _source, _now), do: deny

  defp wait(full, rule, now), do: full + rule.interval_us - now - rule.burst * rule.interval_us

  defp refused(rule, source, vehicle, type, wait_us) do
    rate = "#{whole(Float.round(60_000_000 / rule.interval_us, 1))} times a minute, #{rule.burst} at once"
    wait = whole(Float.ceil(wait_us / 1_000_000, 1))
    Refusal.deny(:rate, source: source, command: named(type), vehicle: vehicle, rate: rate, seconds: wait)
  end

  # A command without a name in the table has that of its MAV_CMD.
  defp named("mav_cmd_" <> number), do: number |> String.to_integer() |> Wording.command()
  defp named(type), do: type

  defp whole(number), do: number |> Aerie.Base.Json.encode!() |> String.replace_suffix(".0", "")
end
