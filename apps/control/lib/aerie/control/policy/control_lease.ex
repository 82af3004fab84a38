defmodule Aerie.Control.Policy.ControlLease do
  @moduledoc """
  Who is in charge of a vehicle: one source at a time, by its name; of a client with several programs, one program by
  its address (`who/1`). A pure value; `Aerie.Control.Policy.ControlLease.Holders` keeps those of a gateway, and the
  rule `Aerie.Control.Policy.Rules.Lease` asks them.

  | change | who may |
  |---|---|
  | take | anybody who may fly, while nobody is in charge; the source that it is offered to; as far as `policy.lease.take_over` allows, a source that gives a reason |
  | offer | the source in charge, which stays in charge until the other one takes it, so that there always is one |
  | release | who is in charge, or an admin |
  """

  alias Aerie.Control.Policy.Roles

  @enforce_keys [:holder, :via, :since]
  defstruct [:holder, :via, :since, :reason, :offered_to, :before, :endpoint]

  @typedoc """
    * `:holder` - the name of the source in charge, by `:via` (`nats`, `rest`, `elixir` or `mavlink`) since then (unix
      microseconds)
    * `:reason` - why it was taken over; nil if it was free or offered
    * `:offered_to` - who may take it without a reason; `:anyone`, or nil for nobody
    * `:before` - who was in charge before
    * `:endpoint` - where the program in charge is connected; nil if it has a name of its own
  """
  @type t :: %__MODULE__{
          holder: String.t(),
          via: String.t(),
          since: integer(),
          reason: String.t() | nil,
          offered_to: String.t() | :anyone | nil,
          before: String.t() | nil,
          endpoint: {String.t(), term()} | nil
        }

  @typedoc """
  What a command asks for. A source that takes it may offer it at once, as MAVLink's allow-takeover flag does.
  """
  @type change ::
          {:take, reason :: String.t() | nil, offer :: :anyone | nil}
          | {:offer, String.t() | :anyone}
          | :release

  @typedoc """
  `:required`: whether nobody may command before taking charge; `:take_over`: the lowest role that may take over.
  """
  @type rules :: %{required: boolean(), take_over: :operator | :admin}

  @doc "By which name a source is in charge: a program's own, or the source's."
  @spec who(%{:name => String.t(), optional(term()) => term()}) :: String.t()
  def who(source), do: Map.get(source, :program) || source.name

  @doc "The lease after a change, nil for nobody in charge, or why the source may not change it."
  @spec change(t() | nil, change(), Roles.source(), via :: String.t(), rules(), now :: integer()) ::
          {:ok, t() | nil} | {:deny, String.t()}
  def change(lease, change, source, via, rules, now) do
    changed(lease, change, %{name: who(source), source: source, via: via, now: now}, rules)
  end

  defp changed(nil, {:take, _reason, offer}, who, _rules), do: {:ok, taken(who, offer)}

  defp changed(%{holder: name} = lease, {:take, _reason, offer}, %{name: name}, _rules),
    do: {:ok, %{lease | offered_to: offer}}

  defp changed(lease, {:take, reason, offer}, who, rules) do
    taken = %{taken(who, offer) | before: lease.holder}

    cond do
      lease.offered_to in [:anyone, who.name, who.source.name] ->
        {:ok, taken}

      rules.take_over == :admin and who.source.role != :admin ->
        {:deny, "#{in_charge(lease)}; only an admin may take over (policy.lease.take_over)"}

      reason == nil ->
        {:deny, "#{in_charge(lease)}; taking over needs a reason"}

      true ->
        {:ok, %{taken | reason: reason}}
    end
  end

  defp changed(nil, _offer_or_release, _who, _rules), do: {:deny, "nobody is in charge"}

  defp changed(%{holder: name} = lease, {:offer, to}, %{name: name}, _rules),
    do: {:ok, %{lease | offered_to: to}}

  defp changed(%{holder: name}, :release, %{name: name}, _rules), do: {:ok, nil}
  defp changed(_lease, :release, %{source: %{role: :admin}}, _rules), do: {:ok, nil}
  defp changed(lease, _offer_or_release, _who, _rules), do: {:deny, in_charge(lease)}

  defp taken(who, offer) do
    %__MODULE__{
      holder: who.name,
      via: who.via,
      since: who.now,
      offered_to: offer,
      endpoint: Map.get(who.source, :endpoint)
    }
  end

  @doc "The lease as a sentence."
  @spec in_charge(t()) :: String.t()
  def in_charge(lease) do
    time = lease.since |> DateTime.from_unix!(:microsecond) |> Calendar.strftime("%H:%M:%S")
    "#{lease.holder} is in charge of the vehicle (since #{time} UTC)"
  end

  @doc "Advice after a refusal. The console has a text of its own."
  @spec take_over() :: String.t()
  def take_over, do: "take_control takes over"

  @doc "The same where nobody is in charge."
  @spec take_first() :: String.t()
  def take_first, do: "needs take_control first"
end
