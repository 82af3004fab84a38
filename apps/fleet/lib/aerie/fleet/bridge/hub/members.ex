defmodule Aerie.Fleet.Bridge.Hub.Members do
  @moduledoc """
  Who is in a fleet: its servers, hubs and vehicles, as `fleet.json` has them, a wish of `Aerie.Fleet.Bridge.Hub.Setup`, and what it means for
  those who are there. Pure.
  """

  alias Aerie.Base.Settings.Types

  # The name of the first hub, in policy.sources of the vehicles.
  @first "hub"

  @typedoc "What `fleet.json` has. A public key of nil is still to be made."
  @type t :: %{String.t() => term()}
  @type place :: :hub | {:hub, String.t()} | {:vehicle, String.t()}
  @typedoc "`vehicles`: whose files are written; `restart` and `reload` of the hub's servers."
  @type changes :: %{
          made: [String.t()],
          revoked: [String.t()],
          vehicles: [String.t()],
          sources?: boolean(),
          hosts?: boolean(),
          clustered?: boolean(),
          servers: :first | :restart | :reload | :none
        }

  @doc "The fleet as it is to be, or why it cannot be."
  @spec plan(t() | nil, map()) :: {:ok, t()} | {:error, String.t()}
  def plan(known, wish) do
    fleet = known || new(wish.environment || "prod")
    fleet = Map.merge(%{"hubs" => %{}, "gateway" => nil}, fleet)

    with {:ok, hosts} <- hosts(wish.hosts, []),
         :ok <- environment(known, wish),
         :ok <- names([fleet["environment"] | wish.vehicles ++ wish.hubs]),
         :ok <- apart(fleet, wish),
         :ok <- known(fleet, wish.revoked -- [@first], "--revoke"),
         :ok <- known(fleet, wish.new_keys, "--new-key"),
         :ok <- first(known, hosts, wish) do
      fleet = if hosts == [], do: fleet, else: %{fleet | "hosts" => hosts}
      {:ok, fleet |> without(wish.revoked) |> renewed(wish.new_keys) |> joined(wish)}
    end
  end

  # Each vehicle has a key of its own that seals its desired states; in sets of earlier versions it does not.
  defp new(environment),
    do: %{"environment" => environment, "hosts" => [], "vehicles" => %{}, "sealing" => "vehicle"}

  defp environment(%{"environment" => environment}, %{environment: other})
       when other not in [nil, environment],
       do: {:error, "the fleet's environment is #{environment}: take another folder for #{other}"}

  defp environment(_known, _wish), do: :ok

  defp names(names) do
    case Enum.find(names, &(Types.parse_token(&1) == :error)) do
      nil -> :ok
      bad -> {:error, "#{inspect(bad)}: a name has at most 64 letters, digits, - and _"}
    end
  end

  # A name is a vehicle's or a hub's.
  defp apart(fleet, wish) do
    vehicles = (Map.keys(fleet["vehicles"]) -- wish.revoked) ++ wish.vehicles
    hubs = [@first | (Map.keys(fleet["hubs"]) -- wish.revoked) ++ wish.hubs]

    cond do
      both = Enum.find(wish.new_keys, &(&1 in wish.revoked)) ->
        {:error, "#{both}: --revoke takes it out, and --new-key gives it another key; choose one"}

      @first in wish.hubs ->
        {:error, "--hub #{@first}: this is the name of the first hub; give another one its own"}

      both = Enum.find(vehicles, &(&1 in hubs)) ->
        {:error, "#{both}: a hub and a vehicle cannot have the same name"}

      @first in wish.revoked ->
        {:error, "--revoke #{@first}: the first hub stays; --new-key #{@first} gives it another key"}

      true ->
        :ok
    end
  end

  defp known(fleet, names, option) do
    there = [@first | Map.keys(fleet["hubs"]) ++ Map.keys(fleet["vehicles"])]

    case Enum.find(names, &(&1 not in there)) do
      nil -> :ok
      unknown -> {:error, "#{option} #{unknown}: there is no such vehicle or hub (#{Enum.join(there, ", ")})"}
    end
  end

  defp first(nil, [], _wish),
    do: {:error, "the hub's name is missing: --host hub.example.org (once for each of its servers)"}

  defp first(_known, _hosts, _wish), do: :ok

  defp hosts([], hosts), do: {:ok, hosts |> Enum.reverse() |> Enum.uniq()}
  defp hosts([text | rest], hosts), do: with({:ok, host} <- host(text), do: hosts(rest, [host | hosts]))

  # A server's name or address as certificates and addresses have it: lower case, without brackets and without the dot
  # of the root.
  defp host(text) do
    bare = text |> String.replace(~r/\A\[(.*)\]\z/, "\\1") |> String.trim_trailing(".")

    case :inet.parse_strict_address(String.to_charlist(bare)) do
      {:ok, address} ->
        if bare =~ "%",
          do: wrong_host(text, "without a zone (%), because vehicles have other ones"),
          else: {:ok, address |> :inet.ntoa() |> List.to_string()}

      {:error, _name} ->
        host_name(text, Types.parse_host(bare))
    end
  end

  defp host_name(text, {:ok, name}) do
    labels = String.split(name, ".")

    cond do
      Enum.any?(labels, &(byte_size(&1) > 63 or &1 =~ ~r/\A-|-\z/)) ->
        wrong_host(text, "a part has at most 63 letters, digits, - and _")

      List.last(labels) =~ ~r/\A\d+\z/ ->
        wrong_host(text, "an IPv4 address has four numbers up to 255")

      true ->
        {:ok, name}
    end
  end

  defp host_name(text, :error) do
    cond do
      text =~ "*" -> wrong_host(text, "each server has a name of its own, not a wildcard")
      text =~ "/" or text =~ ~r/:\d+\z/ -> wrong_host(text, "without a scheme, a port or a path")
      text =~ ~r/[^\x00-\x7F]/u -> wrong_host(text, "written in ASCII, as xn--…")
      true -> wrong_host(text, nil)
    end
  end

  defp wrong_host(text, why),
    do:
      {:error,
       "--host #{inspect(text)}: expected a name such as hub.example.org or an IP address#{why && ": " <> why}"}

  defp without(fleet, names),
    do: %{fleet | "vehicles" => Map.drop(fleet["vehicles"], names), "hubs" => Map.drop(fleet["hubs"], names)}

  defp renewed(fleet, names), do: Enum.reduce(names, fleet, &put(&2, place(&2, &1), nil))

  defp joined(fleet, wish) do
    fleet =
      Enum.reduce(wish.vehicles, fleet, &update_in(&2["vehicles"], fn all -> Map.put_new(all, &1, nil) end))

    Enum.reduce(wish.hubs, fleet, &update_in(&2["hubs"], fn all -> Map.put_new(all, &1, nil) end))
  end

  @doc "Where the key of a name belongs."
  @spec place(t(), String.t()) :: place()
  def place(fleet, name),
    do: if(is_map_key(fleet["vehicles"], name), do: {:vehicle, name}, else: hub_place(name))

  @doc "The same of a hub."
  @spec hub_place(String.t()) :: place()
  def hub_place(@first), do: :hub
  def hub_place(name), do: {:hub, name}

  @doc "Gives one its public key."
  @spec put(t(), place(), String.t() | nil) :: t()
  def put(fleet, :hub, public), do: Map.put(fleet, "gateway", public)
  def put(fleet, {:hub, name}, public), do: put(fleet, "hubs", name, public)
  def put(fleet, {:vehicle, id}, public), do: put(fleet, "vehicles", id, public)

  defp put(fleet, kind, name, public), do: Map.update!(fleet, kind, &Map.put(&1, name, public))

  @doc "Those whose key is still to be made."
  @spec without_key(t()) :: [{String.t(), place()}]
  def without_key(fleet) do
    for {name, nil} <- hubs(fleet) ++ Enum.sort(fleet["vehicles"]), do: {name, place(fleet, name)}
  end

  @doc "The hubs and their public keys, the first one first."
  @spec hubs(t()) :: [{String.t(), String.t() | nil}]
  def hubs(fleet), do: [{@first, fleet["gateway"]} | Enum.sort(fleet["hubs"])]

  @doc "What changes for those who are there. `made`: who got a key."
  @spec changes(t() | nil, t(), made :: [String.t()], map()) :: changes()
  def changes(nil, fleet, made, _wish) do
    %{
      made: made,
      revoked: [],
      vehicles: Map.keys(fleet["vehicles"]),
      sources?: false,
      hosts?: false,
      clustered?: false,
      servers: :first
    }
  end

  def changes(known, fleet, made, wish) do
    sources? = hubs(fleet) != hubs(Map.put_new(known, "hubs", %{}))
    hosts? = fleet["hosts"] != known["hosts"]
    added = for id <- Map.keys(fleet["vehicles"]), id in made, do: id
    everyone = Map.keys(fleet["vehicles"])

    %{
      made: made,
      revoked: wish.revoked -- made,
      vehicles: if(sources? or hosts?, do: everyone, else: added),
      sources?: sources?,
      hosts?: hosts?,
      clustered?: match?([_one], known["hosts"]) and length(fleet["hosts"]) > 1,
      servers:
        cond do
          added != [] or hosts? -> :restart
          sources? or wish.revoked != [] -> :reload
          true -> :none
        end
    }
  end
end
