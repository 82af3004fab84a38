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
  alias Aerie.Vehicle.Command.Refusal

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
          {:ok, t() | nil} | Refusal.denial()
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
        Refusal.deny(:take_over_admin, holder: lease.holder, since: since(lease))

      reason == nil ->
        Refusal.deny(:take_over_reason, holder: lease.holder, since: since(lease))

      true ->
        {:ok, %{taken | reason: reason}}
    end
  end

  defp changed(nil, _offer_or_release, _who, _rules), do: Refusal.deny(:nobody_in_charge)

  defp changed(%{holder: name} = lease, {:offer, to}, %{name: name}, _rules),
    do: {:ok, %{lease | offered_to: to}}

  defp changed(%{holder: name}, :release, %{name: name}, _rules), do: {:ok, nil}
  defp changed(_lease, :release, %{source: %{role: :admin}}, _rules), do: {:ok, nil}

  defp changed(lease, _offer_or_release, _who, _rules),
    do: Refusal.deny(:in_charge, holder: lease.holder, since: since(lease))

  defp taken(who, offer) do
    %__MODULE__{
      holder: who.name,
      via: who.via,
      since: who.now,
      offered_to: offer,
      endpoint: Map.get(who.source, :endpoint)
    }
  end

  @doc "Since what time of the day, UTC."
  @spec since(t()) :: String.t()
  def since(lease), do: lease.since |> DateTime.from_unix!(:microsecond) |> Calendar.strftime("%H:%M:%S")
end
