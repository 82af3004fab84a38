defmodule Aerie.Access.Principals do
  @moduledoc """
  The principal (`Aerie.Base.Principal`) of a request or a page, by what was shown for it. Pure.

  | what was shown | kind | name | role | changes the gateway as | commands as |
  |---|---|---|---|---|---|
  | a session of a user | `:user` | its name | its role | its role | its role |
  | a session of the printed address | `:user` | `local` | `:admin` | its role | its role |
  | a key | `:key` | its name | its role | its role | its role |
  | a key without a role | `:key` | its name | nil | `:admin` | `:admin` |
  | nothing, by a program of this machine | `:client` | `local` | `:viewer` | `:operator` | `:viewer` |

  A ticket stands for the principal that it was issued to. Over a WebSocket `policy.clients` says what a key without a
  role and a program without a key may do.

  Without a key a program of this machine gets in only while no keys exist. Any user of the machine may be behind it, so
  it is never more than an operator, and nobody who may command vehicles.
  """

  alias Aerie.Access.{Keys, Users}
  alias Aerie.Base.Principal
  alias Aerie.Control.Policy.Roles

  @doc "The principal of a user, of a key, of the printed address, or of a program of this machine."
  @spec of(Users.user() | Keys.key() | :printed_address | :program) :: Principal.t()
  def of(%{password: _stored} = user), do: Roles.principal(:user, user.name, user.role, user.permissions)
  def of(%{digest: _, role: nil} = key), do: %{of(%{key | role: :admin}) | role: nil}
  def of(%{digest: _} = key), do: Roles.principal(:key, key.name, key.role, key.permissions)
  def of(:printed_address), do: Roles.principal(:user, "local", :admin)
  def of(:program), do: Roles.principal(:client, "local", :viewer)

  @doc "The role in which somebody changes the gateway."
  @spec role(Principal.t()) :: Roles.role()
  def role(%Principal{kind: :client}), do: :operator
  def role(%Principal{role: role}), do: role || :admin

  @doc "As whom somebody commands."
  @spec commanding(Principal.t()) :: Roles.source()
  def commanding(%Principal{role: role} = principal), do: %{principal | role: role || :admin}
end
