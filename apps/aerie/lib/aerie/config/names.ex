defmodule Aerie.Config.Names do
  @moduledoc """
  Names in rules that must be those of something: of a client, a link, a source of commands, a vehicle. A rule for a name that
  nobody has would silently do nothing.

  With links or clients from the command line, which replace those of the file, what is not there is a warning. So is a vehicle
  that may be another gateway's.
  """

  import Aerie.Base.Settings.Rules

  alias Aerie.{Config, Vehicle}
  alias Aerie.Control.Commands
  alias Aerie.Base.Settings.Schema
  alias Aerie.Access.Keys
  alias Aerie.Access.Users
  alias MavRouter.Link.Transport.Msp.Share

  # Parts of the gateway that command in their own name, and commands over NATS that nobody signed.
  @own ["bin/aerie", "shadow", "unsigned"]

  @typep named :: {Schema.path(), name :: String.t()}

  @doc "Errors, and warnings."
  @spec check(Config.t()) :: {[Schema.problem()], warnings :: [String.t()]}
  def check(%Config{} = config) do
    ends = ends(config)
    own? = not Enum.any?(["links", "clients"], &(config.given[&1] == "command line"))

    clients =
      unknown(
        clients(config),
        &(&1 in ends),
        "the id of a client or link",
        ends,
        "one that is added later has the entry without an id"
      )

    filters =
      unknown(filters(config) ++ carried(config), &(&1 in ends), "the id of a link or client", ends, nil)

    sources = sources(config, ends)

    rates =
      unknown(rates(config, :sources), &(&1 in sources), "the name of a source of commands", sources, nil)

    fleet =
      unknown(
        rates(config, :vehicles),
        &vehicle?(config, &1),
        "the name of a vehicle",
        ids(config.vehicles),
        others(config)
      )

    {problems, doubts} =
      if own?, do: {clients ++ filters ++ rates, []}, else: {[], clients ++ filters ++ rates}

    if config.remote.enabled,
      do: {problems, texts_of(doubts ++ fleet)},
      else: {problems ++ fleet, texts_of(doubts)}
  end

  defp texts_of(problems),
    do:
      for(
        %{path: path} = problem <- problems,
        do: "#{Config.Error.path(path)}: #{problem.got} is not #{problem.expected}"
      )

  # The senders of incoming frames, by the ids that the policy and filters see.
  defp ends(config) do
    clients =
      if config.clients == :default, do: [MavRouter.Client.Boot.default_id()], else: ids(config.clients)

    shares = for %{id: id, spec: %{share: share}} <- config.links, share != nil, do: Share.client(id)
    Enum.uniq(ids(config.links) ++ shares ++ clients)
  end

  defp ids(list), do: Enum.map(list, & &1.id)

  # All who may sign a command, or give one by a key or as a user.
  defp sources(config, ends) do
    keys = with {:ok, keys} <- Keys.load(config.api), do: keys, else: (_reported -> [])

    users =
      with {:ok, users} <- config.console.dir |> Users.file() |> Users.read(),
           do: users,
           else: (_reported -> [])

    Enum.uniq(
      ends ++
        Enum.map(config.policy.sources ++ keys ++ users, & &1.name) ++
        [Commands.inside().name | @own]
    )
  end

  @spec clients(Config.t()) :: [named()]
  defp clients(%{policy: %{clients: clients}}) do
    for {%{id: id}, index} <- Enum.with_index(clients),
        id != nil,
        do: {["policy", "clients", index, "id"], id}
  end

  defp rates(%{policy: %{rates: rates}}, key) do
    for {rate, index} <- Enum.with_index(rates || []), name <- rate[key] || [] do
      {["policy", "rates", index, Atom.to_string(key)], name}
    end
  end

  defp filters(config) do
    for {section, list} <- [
          {"links", config.links},
          {"clients", MavRouter.Client.Settings.listed(config)}
        ],
        {%{filter_out: filter}, index} <- Enum.with_index(list),
        key <- [:allow_sources, :block_sources],
        name <- filter[key] || [],
        do: {[section, index, "filter_out", Atom.to_string(key)], name}
  end

  # Keys of a group; `all` is for all of its links.
  defp carried(config) do
    for {link, index} <- Enum.with_index(config.links),
        {class, name} <- link[:carry] || %{},
        name != "all",
        do: {["links", index, "carry", class], name}
  end

  @doc "Whether a vehicle of one of the networks has this name, or would get it."
  @spec vehicle?(Config.t(), String.t()) :: boolean()
  def vehicle?(config, name) do
    settings = Vehicle.Settings.from(config)

    with false <- name == config.vehicle_id or name in ids(config.vehicles),
         [digits] <- Regex.run(~r/\d{1,10}\z/, name) do
      Enum.any?(
        Config.networks(config),
        &(Vehicle.Options.id(settings, {&1, String.to_integer(digits)}) == name)
      )
    else
      true -> true
      nil -> false
    end
  end

  @doc "The names of vehicles, for a name that none can have."
  @spec vehicles(Config.t()) :: String.t()
  def vehicles(config),
    do: [known(ids(config.vehicles)), others(config)] |> Enum.filter(& &1) |> Enum.join("; ")

  defp others(config) do
    [_own | others] = Config.networks(config)
    words = for prefix <- ["VID" | others], do: prefix <> "-"
    "others are #{Enum.join(words, " or ")} and three digits"
  end

  @spec unknown([named()], (String.t() -> boolean()), String.t(), [String.t()], String.t() | nil) :: [
          Schema.problem()
        ]
  defp unknown(named, known?, expected, names, hint) do
    for {path, name} <- named, not known?.(name) do
      hints = [Schema.did_you_mean(name, names), known(names), hint]
      problem(path, expected, Schema.show(name), hints |> Enum.filter(& &1) |> Enum.join("; "))
    end
  end

  defp known([]), do: nil

  defp known(names),
    do: "known are #{names |> Enum.take(12) |> Enum.join(", ")}#{if length(names) > 12, do: ", …"}"
end
