defmodule FleetWeb.Console.Access.Role do
  @moduledoc "The order of roles: viewer, operator, admin."

  alias Aerie.Control.Policy.Roles

  @doc "Whether a role may do what `least` may."
  @spec at_least?(Roles.role(), Roles.role()) :: boolean()
  defdelegate at_least?(role, least), to: FleetWeb.Rights

  @doc "The role with a name from outside."
  @spec parse(term()) :: {:ok, Roles.role()} | :error
  def parse(name) do
    case Enum.find(Roles.all(), &(Atom.to_string(&1) == name)) do
      nil -> :error
      role -> {:ok, role}
    end
  end
end
