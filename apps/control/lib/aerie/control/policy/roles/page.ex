defmodule Aerie.Control.Policy.Roles.Page do
  @moduledoc """
  The tables of `docs/policy.md` and `docs/security.md` that say who can do what: made from the roles, from `Aerie.Control.Policy.principal/2`
  and from the tables of messages and commands (`MavCodec.Meaning.Messages`, `MavCodec.Meaning.Commands`). `mix aerie.authority` renews
  them.
  """

  alias MavCodec.Meaning.{Commands, Messages, Pilot, Shaping}
  alias Aerie.Base.Principal
  alias Aerie.Vehicle.Command.Page, as: Markdown
  alias Aerie.Vehicle.Command.Type
  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Roles
  alias MavCodec.Dialects.All

  # Every way by which MAVLink comes in, as the path of an endpoint says it.
  @ways [
    {"a client of `clients` on this machine, `mavlink.sock`, a WebSocket without a key",
     %{side: :client, commands: true, local: true}},
    {"a client of `clients` beyond this machine", %{side: :client, commands: true, local: false}},
    {"a program of this machine on a link", %{side: :vehicle, commands: true, local: true}},
    {"anybody on a link with `gcs: allow`", %{side: :vehicle, commands: true, local: false}},
    {"anybody else on a link, a ground station included", %{side: :vehicle, commands: false, local: false}}
  ]
  @keys for role <- Roles.all(), do: {role, "`role=#{role}`"}

  @doc "The sections of docs/policy.md by their names."
  @spec sections() :: %{String.t() => String.t()}
  def sections do
    %{
      "ways" => ways(),
      "roles" => roles(),
      "pilot" => pilot(),
      "messages" => messages(),
      "mav-commands" => commands(),
      "shaping" => shaping()
    }
  end

  defp roles do
    may = fn role -> if(Roles.permissions(role) == [], do: "look on", else: list(Roles.permissions(role))) end
    Markdown.table(["role", "may"], for(role <- Roles.all(), do: ["`#{role}`", may.(role)]))
  end

  defp pilot do
    rows =
      for {name, least, most, unit, what} <- Pilot.all(),
          do: ["`#{name}`", what, "#{least} to #{most} #{unit}"]

    Markdown.table(["parameter", "is", "bounds"], rows)
  end

  # The parameters that shape paths, and how many metres one counts that is not known.
  defp shaping do
    rows = Enum.group_by(Shaping.all(), &{&1.shapes, &1.meaning, &1.assumed})

    table =
      for {{shapes, meaning, assumed}, rows} <- Enum.sort(rows),
          do: ["#{shapes}", meaning, names(rows), if(assumed, do: "#{assumed} m", else: "")]

    Markdown.table(["shapes", "what", "parameters", "not known yet"], table)
  end

  defp names(rows), do: Enum.map_join(rows, ", ", &"`#{&1.name}`")

  @doc "What each interface may send without an entry of `policy.clients`."
  @spec ways() :: String.t()
  def ways do
    {:ok, policy} = Policy.compile(%{})
    origin = %{owner: "id", text: nil, principal: nil, auto: false}
    unlisted = for {text, path} <- @ways, do: way(text, Policy.principal(policy, Map.merge(origin, path)))

    keys =
      for {role, text} <- @keys ++ [{nil, "without a role"}] do
        proved = %Principal{kind: :key, name: "id", role: role}
        path = Map.merge(origin, %{side: :client, commands: true, local: false, principal: proved})
        way("a WebSocket with a key #{text}", Policy.principal(policy, path))
      end

    vehicle = [
      "a vehicle, and what says that it is one",
      "none",
      "nothing to other vehicles but heartbeats (`router.between_vehicles`); everything to its own parts"
    ]

    Markdown.table(["MAVLink from", "role", "may"], unlisted ++ keys ++ [vehicle])
  end

  defp way(text, %{role: role, may: []}),
    do: [
      text,
      "`#{role}`",
      "look on: nothing that it sends reaches a vehicle; the gateway asks for it, within a budget"
    ]

  defp way(text, %{role: role, may: may}), do: [text, "`#{role}`", list(may)]

  defp messages do
    rows = for id <- All.ids(), row = Messages.row(id), do: {row, All.name(id)}

    rows
    |> Enum.group_by(&elem(&1, 0), &elem(&1, 1))
    |> Enum.sort_by(fn {row, _names} ->
      {order(row.class), row.permission, row.limited, row.crosses, row.part, row.per_minute}
    end)
    |> Enum.map(fn {row, names} ->
      [
        label(row.class),
        needs(row),
        who_else(row),
        if(row.per_minute > 0, do: "#{row.per_minute}", else: ""),
        names |> Enum.sort() |> Enum.join(", ")
      ]
    end)
    |> then(&Markdown.table(["class", "a client needs", "others", "asked a minute", "messages"], &1))
  end

  defp needs(%{permission: nil}), do: "nobody"
  defp needs(%{limited: true, permission: permission}), do: "`#{permission}`, and `inputs` where limited"
  defp needs(%{permission: permission}), do: "`#{permission}`"

  @classes ~w(telemetry presence question answer input stick setpoint command parameter mission file internal)a
  defp order(class), do: Enum.find_index(@classes, &(&1 == class))
  defp label(:setpoint), do: "set-point"
  defp label(class), do: Atom.to_string(class)

  defp who_else(row) do
    crosses = %{always: ["other vehicles"], team: ["other vehicles with `between_vehicles: all`"], never: []}
    part = if row.part, do: ["parts"], else: []
    Enum.join(crosses[row.crosses] ++ part, "; ")
  end

  defp commands do
    Commands.all()
    |> Enum.group_by(&{&1.permission, &1.class}, & &1.name)
    |> Enum.sort_by(fn {{permission, class}, _names} ->
      {Enum.find_index(Type.permissions(), &(&1 == permission)), class}
    end)
    |> Enum.map(fn {{permission, class}, names} ->
      [
        "`#{permission}`",
        role(permission),
        if(class == :question, do: "question", else: "command"),
        names |> Enum.sort() |> Enum.join(", ")
      ]
    end)
    |> then(&Markdown.table(["needs at least", "in role", "", "MAV_CMD"], &1))
  end

  defp role(permission) do
    case Enum.find(Roles.all(), &(permission in Roles.permissions(&1))) do
      nil -> "none"
      role -> Atom.to_string(role)
    end
  end

  defp list(permissions), do: permissions |> Enum.sort() |> Enum.map_join(", ", &"`#{&1}`")
end
