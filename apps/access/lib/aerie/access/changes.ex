defmodule Aerie.Access.Changes do
  @moduledoc """
  What people and programs change of the gateway by console, `/api` and command line, for the audit log: who,
  from where, what; never a password or a key. The functions that change something write it themselves, so no
  page can forget to.

  A request of `/api` that changes something is recorded by its route (`Aerie.Api.Rest.Handler`) unless
  `recorded_elsewhere/0` lists its action.
  """

  alias Aerie.Access.Changes.Rights
  alias Aerie.Base.{Json, Names}
  alias Aerie.Base.Net.Address
  alias Aerie.Control.Policy.Audit
  alias Aerie.Control.Policy.Roles

  @typedoc "Somebody who changes something: a name for people, with the address of the computer if it is known."
  @type by :: String.t() | %{name: String.t(), from: String.t() | nil}

  # Commands, transfers and desired states are decided by the policy, which records them; so do the two that
  # reload. A ticket only stands for the key that asks for it, and an operation is commands.
  @elsewhere [
    :command,
    :cancel_command,
    :reload_policy,
    :reload_config,
    :issue_ticket
  ]
  # Longer answers are not copied.
  @most 2_000

  @doc "The actions of `/api` whose records come from somewhere else."
  @spec recorded_elsewhere() :: [atom()]
  def recorded_elsewhere, do: @elsewhere

  @doc "Whether a change by a request is recorded by its route; nil stands for no change."
  @spec recorded?(Rights.change() | nil) :: boolean()
  def recorded?(change), do: change != nil and change not in @elsewhere

  @doc "The name of somebody."
  @spec name(by()) :: String.t()
  def name(%{name: name}), do: name
  def name(name), do: name

  @doc "The user of a page."
  @spec user(assigns :: map()) :: by()
  def user(%{user: user} = assigns), do: %{name: "console:" <> user.name, from: place(assigns[:peer])}

  @doc "An address as the log has it."
  @spec place(:inet.ip_address() | nil) :: String.t() | nil
  def place(nil), do: nil
  def place(peer), do: peer |> :inet.ntoa() |> to_string()

  @doc "Records a change that was made."
  @spec note(Names.gateway(), by(), type :: String.t(), %{String.t() => term()}) :: :ok
  def note(gateway, by, type, fields) do
    who = %{"type" => type, "source" => name(by), "from" => if(is_map(by), do: by.from)}
    Audit.note(gateway, who |> Map.merge(fields) |> Map.reject(fn {_key, value} -> value == nil end))
  end

  @doc "Records a request of `/api` that changed something, by its answer."
  @spec request(Names.gateway(), by(), action :: atom(), target :: term(), answer :: term()) :: :ok
  def request(gateway, by, action, target, answer) do
    target = if is_map(answer) and is_binary(answer[:id]), do: answer.id, else: target
    url = if is_map(answer), do: answer[:url]

    note(gateway, by, "change", %{
      "action" => Atom.to_string(action),
      "target" => if(is_binary(target), do: target),
      "url" => if(is_binary(url), do: Address.shown(url)),
      "now" => if(action in [:change_rules, :change_log, :record_link, :record_vehicle], do: short(answer))
    })
  end

  defp short(answer) do
    plain = Json.plain(answer)
    if byte_size(Json.encode!(plain)) <= @most, do: plain
  end

  @doc """
  Records that somebody signed in or out, or tried to. Failures are summed up for each address. A name that
  nobody has is left out, because it may be a password.
  """
  @spec sign_in(
          Names.gateway(),
          outcome :: atom(),
          via :: String.t(),
          name :: String.t() | nil,
          :inet.ip_address()
        ) :: :ok
  def sign_in(gateway, outcome, via, name, peer) do
    from = place(peer)

    entry = %{
      "type" => "sign_in",
      "outcome" => Atom.to_string(outcome),
      "via" => via,
      "source" => name,
      "from" => from
    }

    if outcome in [:signed_in, :launched, :signed_out],
      do: Audit.note(gateway, entry),
      else: Audit.refusal(gateway, Roles.principal(:stranger, "#{via} from #{from}", :viewer), outcome, entry)
  end
end
