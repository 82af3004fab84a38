defmodule Aerie.Control.Policy.Roles do
  @moduledoc """
  What a source may ask for, by its role:

  | role | may |
  |---|---|
  | `viewer` | look on |
  | `operator` | `arm`, `fly`, `mission`, `manual`, `payload`, `telemetry`, `sensors` |
  | `pilot` | the same, and `pilot`: heights and speeds, home in flight, the vehicle's own fence, its logs |
  | `admin` | the same, and `maintain`, `protection` and `inputs` |

  No role includes `force_disarm` and `terminate`, which can bring a vehicle down on somebody, nor `receiver` and
  `motors`, which arm vehicles with MSP and turn their motors: they are given by name, to an operator or an admin.
  """

  alias Aerie.Base.Principal
  alias Aerie.Vehicle.Command.Type

  @operator [:arm, :fly, :mission, :manual, :payload, :telemetry, :sensors]
  @pilot [:pilot | @operator]
  # From the one that may least.
  @roles [viewer: [], operator: @operator, pilot: @pilot, admin: [:maintain, :protection, :inputs | @pilot]]
  @names Keyword.keys(@roles)
  @own [:force_disarm, :terminate, :receiver, :motors]

  @type role :: :viewer | :operator | :pilot | :admin

  @typedoc """
  The source of a command, as authentication found out: a name for people, a role, and permissions beyond the role.
  """
  @type source :: Principal.t()

  @doc "All roles, from the one that may least."
  @spec all() :: [role(), ...]
  def all, do: @names

  @doc "The names of all roles, in words."
  @spec text() :: String.t()
  def text do
    {others, [last]} = Enum.split(@names, -1)
    Enum.join(others, ", ") <> " or #{last}"
  end

  @doc "Whether a role may do what `least` may."
  @spec at_least?(role(), role()) :: boolean()
  def at_least?(role, least), do: rank(role) >= rank(least)

  defp rank(role), do: Enum.find_index(@names, &(&1 == role))

  @doc "The role with a name from outside."
  @spec parse(term()) :: {:ok, role()} | :error
  def parse(name),
    do: with(nil <- Enum.find(all(), &(Atom.to_string(&1) == name)), do: :error, else: (role -> {:ok, role}))

  @doc "The permissions that no role includes."
  @spec own() :: [Type.permission(), ...]
  def own, do: @own

  @doc "Why something needs a permission that not everybody has, in words; empty for the ordinary ones."
  @spec guards(Type.permission()) :: String.t()
  def guards(:terminate), do: "it may end the flight"
  def guards(:force_disarm), do: "it may stop the motors in flight"
  def guards(:protection), do: "it changes what protects the vehicle"
  def guards(:maintain), do: "it changes how the vehicle is set up"
  def guards(:receiver), do: "it arms and steers in the place of the pilot's transmitter"
  def guards(:motors), do: "it turns motors on the ground"
  def guards(:inputs), do: "it may lead a vehicle around a fence"
  def guards(:pilot), do: "it changes heights and speeds of a flight"
  def guards(_ordinary), do: ""

  @doc "The permissions of a role."
  @spec permissions(role()) :: [Type.permission()]
  def permissions(role), do: Keyword.fetch!(@roles, role)

  @doc "The permissions that can be given beyond a role; a viewer can be given none."
  @spec beyond(role()) :: [Type.permission()]
  def beyond(:viewer), do: []
  def beyond(role), do: Type.permissions() -- permissions(role)

  @doc "Permissions beyond a role by their names from outside, in their order; an error in words."
  @spec given(role(), term()) :: {:ok, [Type.permission()]} | {:error, String.t()}
  def given(role, names) when is_list(names) do
    case for(name <- names, is_binary(name), do: name) -- Enum.map(beyond(role), &Atom.to_string/1) do
      [] when names == [] ->
        {:ok, []}

      [] ->
        {:ok, for(permission <- beyond(role), Atom.to_string(permission) in names, do: permission)}

      [_ | _] when role == :viewer ->
        {:error, "a viewer may do nothing, whatever it is given: give another role first"}

      [_ | _] ->
        {:error, "expected permissions beyond the role #{role}: #{Enum.join(beyond(role), ", ")}"}
    end
  end

  def given(_role, _other), do: {:error, "expected a list of permissions"}

  @doc "Somebody with a role, and permissions beyond it."
  @spec principal(Principal.kind(), String.t(), role(), [Type.permission()]) :: Principal.t()
  def principal(kind, name, role, permissions \\ []) do
    %Principal{
      kind: kind,
      name: name,
      role: role,
      permissions: permissions,
      may: may(%{role: role, permissions: permissions})
    }
  end

  @doc "All that somebody with a role and permissions beyond it may do."
  @spec may(%{:role => role(), :permissions => [Type.permission()], optional(term()) => term()}) :: [
          Type.permission()
        ]
  def may(%{role: :viewer}), do: []
  def may(%{role: role, permissions: more}), do: permissions(role) ++ more

  @doc "Whether a source has a permission. One that is not known has none; a viewer has none, whatever it was given."
  @spec allowed?(source() | nil, Type.permission()) :: boolean()
  def allowed?(nil, _permission), do: false
  def allowed?(%{role: :viewer}, _permission), do: false

  def allowed?(source, permission),
    do: permission in permissions(source.role) or permission in source.permissions
end
