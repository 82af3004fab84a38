defmodule Aerie.Control.Policy do
  @moduledoc """
  Who may command what, where, when and how high: a value that is compiled from the section `policy` of the
  configuration and a fence file, and asked about each command.

      {:ok, policy} = Aerie.Control.Policy.compile(%{max_altitude: 120.0, geofence_file: "fence.geojson"})
      Aerie.Control.Policy.decide(policy, command, context)
      #=> {:deny, :altitude, "the target is 150 m above home; at most 120 m is allowed"}

  There is no process and no state. Its owner may replace it between two commands. A rule that lacks what it
  needs to know denies. `docs/policy.md` describes the rules with examples.
  """

  alias Aerie.Base.{Names, Principal}
  alias Aerie.Vehicle.Command

  alias Aerie.Control.Policy.{Compile, ControlLease, Fence, Intent, Rate, Roles}
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Control.Policy.ControlLease.Holders
  alias Aerie.Control.Policy.Intent.Protection

  alias Aerie.Control.Policy.{Rules, Store}
  alias Aerie.Control.Policy.Roles.Sources

  @enforce_keys [:modes, :lease, :audit_required]
  defstruct [
    :max_altitude,
    :min_altitude,
    :max_altitude_msl,
    :takeoff_battery,
    :ready_battery,
    :fence,
    :modes,
    :unsigned,
    :lease,
    :audit_required,
    unknown: :refuse,
    open: [],
    conditions: %{},
    windows: [],
    rates: [],
    clients: [],
    sources: []
  ]

  @type t :: %__MODULE__{
          max_altitude: number() | nil,
          min_altitude: number() | nil,
          max_altitude_msl: number() | nil,
          takeoff_battery: number() | nil,
          ready_battery: number(),
          fence: Fence.t() | nil,
          modes: Rules.Mode.modes(),
          unknown: :refuse | :maintain,
          open: [Intent.unknown()],
          conditions: %{String.t() => Rules.Condition.condition()},
          windows: [Rules.Window.window()],
          rates: [Rate.rule()],
          clients: [client()],
          sources: [Sources.listed()],
          unsigned: Roles.role() | nil,
          lease: ControlLease.rules(),
          audit_required: boolean()
        }

  @typedoc "What a client that sends raw MAVLink may do: one by its id, all others by nil."
  @type client :: %{id: String.t() | nil, role: Roles.role(), permissions: [Command.Type.permission()]}

  @typedoc "A rule of `Aerie.Vehicle.Command.Refusal`."
  @type rule :: atom()
  @type decision :: :allow | {:deny, rule(), reason :: String.t()}

  @doc "The policy that a gateway asks; nil: it has none, so nobody may command anything."
  @spec in_force(Names.gateway()) :: t() | nil
  defdelegate in_force(gateway), to: Store, as: :get

  @doc "Since when it is in force, and why a newer one is not; nil without a policy."
  @spec status(Names.gateway()) :: Store.status() | nil
  defdelegate status(gateway), to: Store

  @doc "Reads it and its fences again, for `by`; the old one stays in force if there is an error."
  @spec reload(Names.gateway(), by :: String.t()) :: :ok | {:error, [String.t(), ...]}
  defdelegate reload(gateway, by), to: Store

  @doc """
  Who signed a message (`Aerie.Control.Policy.Roles.Signature`). A command has an `id` that its sender chose, so that a
  copy has the same one.
  """
  @spec signer(Names.gateway(), header :: String.t(), subject :: String.t(), body :: binary(), id :: term()) ::
          {:ok, Roles.source()} | {:deny, rule(), String.t()}
  def signer(gateway, header, subject, body, id \\ "") do
    with :ok <- Sources.identified(id),
         do: gateway |> in_force() |> Sources.identify(header, subject, body, System.os_time(:microsecond))
  end

  @doc "Who is in charge of a vehicle; nil for nobody."
  @spec control_lease(Names.gateway(), Holders.vehicle()) :: ControlLease.t() | nil
  defdelegate control_lease(gateway, key), to: Holders, as: :of

  @doc "Who is in charge of each vehicle that somebody has taken."
  @spec control_leases(Names.gateway()) :: %{Holders.vehicle() => ControlLease.t()}
  defdelegate control_leases(gateway), to: Holders, as: :all

  @doc "The polygons of a policy's zones: of what kind and name, and their rings of `{latitude, longitude}`."
  @spec zones(t() | nil) :: [%{kind: atom(), name: String.t() | nil, rings: [[{float(), float()}]]}]
  def zones(%__MODULE__{fence: %{zones: zones}}) do
    for zone <- zones,
        polygon <- zone.polygons,
        do: %{kind: zone.kind, name: zone.name, rings: Fence.Polygon.rings(polygon)}
  end

  def zones(_without), do: []

  @doc "Whether a parameter protects people or the vehicle, so that changing it needs a permission of its own."
  @spec protects?(name :: String.t()) :: boolean()
  defdelegate protects?(name), to: Protection, as: :parameter?

  @doc """
  The names of the rules, in the order in which they are asked. Rates are asked before them
  (`Aerie.Control.Policy.Rate`).
  """
  @spec rules() :: [rule(), ...]
  defdelegate rules, to: Rules, as: :names

  @doc "The counters of its decisions, in the read model."
  @spec counters() :: [{:policy, :allow | :deny, atom()}]
  def counters,
    do: [{:policy, :allow, nil} | for(rule <- [:rate, :audit | rules()], do: {:policy, :deny, rule})]

  @doc "A policy from a section, or a line for everything that is wrong with it."
  @spec compile(map()) :: {:ok, t()} | {:error, [String.t(), ...]}
  def compile(section) do
    with {:error, errors} <- Compile.policy(section), do: {:error, Enum.map(errors, &Compile.text/1)}
  end

  @doc "Whether a command is allowed. The first rule that denies it gives the reason."
  @spec decide(t(), Command.t() | Intent.t(), Context.t()) :: decision()
  def decide(policy, %Command{} = command, context), do: decide(policy, Intent.of(command), context)

  def decide(policy, %Intent{} = facts, context), do: Rules.check(Rules.names(), policy, facts, context)

  @doc """
  The part of the decision that depends on the command and its sender alone. It comes before anything is remembered of a
  sender, so that one who may nothing takes nobody's room.
  """
  @spec admit(t(), Command.t() | Intent.t(), Context.t()) :: decision()
  def admit(policy, %Command{} = command, context), do: admit(policy, Intent.of(command), context)
  def admit(policy, %Intent{} = facts, context), do: Rules.check(Rules.of_sender(), policy, facts, context)

  @doc "Whether nobody else is in charge of the vehicle, for what is not judged by the other rules."
  @spec in_charge?(t(), Intent.t(), Context.t()) :: boolean()
  def in_charge?(policy, facts, context), do: Rules.check([:lease], policy, facts, context) == :allow

  @typedoc "What the policy must know of where a frame came from: a `MavRouter.Forward.Table.Path`."
  @type origin :: %{
          :owner => String.t(),
          :text => String.t() | nil,
          :principal => Principal.t() | nil,
          :commands => boolean(),
          :local => boolean(),
          :side => :vehicle | :client,
          :auto => boolean(),
          optional(term()) => term()
        }

  @doc """
  The sender of raw MAVLink, in this order: who proved it by a key or by signing in; an entry of `policy.clients` with
  the client's or link's id; the entry without an id. Without any of these it is an operator on this machine, and on a
  link with `gcs: allow`; elsewhere a viewer. A sender on a link that does not count as a client is a viewer, whatever
  is listed.
  """
  @spec principal(t(), origin()) :: Principal.t()
  def principal(_policy, %{commands: false} = origin),
    do: made(:stranger, origin, %{role: :viewer, permissions: []})

  def principal(_policy, %{principal: %Principal{role: role} = proved}) when role != nil,
    do: %{proved | may: Roles.may(proved)}

  # A key without a role.
  def principal(policy, %{principal: %Principal{} = proved}) do
    found = listed(policy, nil) || %{role: :admin, permissions: []}
    proved = %{proved | role: found.role, permissions: Enum.uniq(found.permissions ++ proved.permissions)}
    %{proved | may: Roles.may(proved)}
  end

  def principal(policy, %{owner: owner} = origin),
    do: made(:client, origin, listed(policy, owner) || listed(policy, nil) || unlisted(origin))

  defp listed(policy, id), do: Enum.find(policy.clients, &(&1.id == id))

  defp unlisted(%{local: true}), do: %{role: :operator, permissions: []}
  defp unlisted(%{side: :vehicle}), do: %{role: :operator, permissions: []}
  defp unlisted(%{auto: true}), do: %{role: :operator, permissions: []}
  defp unlisted(_beyond), do: %{role: :viewer, permissions: []}

  defp made(kind, %{owner: owner, text: text} = origin, %{role: role, permissions: permissions} = found) do
    %Principal{
      kind: kind,
      name: owner,
      role: role,
      permissions: permissions,
      may: Roles.may(found),
      program: if(text, do: "#{owner} #{text}"),
      endpoint: Map.get(origin, :key)
    }
  end
end
