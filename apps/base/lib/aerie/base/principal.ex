defmodule Aerie.Base.Principal do
  @moduledoc """
  The sender of a frame or request: a value that is made where it enters, and travels with it.

  | kind | made of |
  |---|---|
  | `:vehicle` | a component of a system whose autopilot is heard by the same endpoint |
  | `:client` | a ground station or another program that may command: a peer of `clients`, a program of this machine, a peer of a link with `gcs: allow` |
  | `:key` | the owner of an API key |
  | `:user` | somebody who signed in to the console |
  | `:gateway` | the gateway itself |
  | `:stranger` | a peer of a link to vehicles that is none of these |

  `permissions` are those beyond the role's; `may` is all that it may do, worked out once (`:all` for a router without a
  policy). `program` tells the programs of one client apart (the address of each), and `endpoint` is where they are
  connected; both are nil for a sender with a name of its own.
  """

  @enforce_keys [:kind, :name]
  defstruct [:kind, :name, :role, :program, :endpoint, permissions: [], may: []]

  @type kind :: :vehicle | :client | :key | :user | :gateway | :stranger

  @type t :: %__MODULE__{
          kind: kind(),
          name: String.t(),
          role: :viewer | :operator | :pilot | :admin | nil,
          permissions: [atom()],
          program: String.t() | nil,
          endpoint: {String.t(), term()} | nil,
          may: :all | [atom()]
        }

  @doc "Whether it has a permission. `nil` marks an operation that no permission grants."
  @spec may?(t(), atom() | nil) :: boolean()
  def may?(_principal, nil), do: false
  def may?(%__MODULE__{may: :all}, _permission), do: true
  def may?(%__MODULE__{may: permissions}, permission), do: permission in permissions
end
