defmodule Aerie.Console.Frame.Palette do
  @moduledoc """
  What a few letters lead to (Ctrl+K): vehicles, pages, and for the vehicle whose page is shown its commands' forms
  and its parameters. It only leads there: nothing is sent from it.
  """

  alias Aerie.Base.{Names, Store}
  alias Aerie.Fleet
  alias Aerie.Console.Commands.Catalog
  alias Aerie.Console.Pages
  alias Aerie.Console.Pages.Vehicle.Sections
  alias Aerie.Control.Params
  alias Aerie.Control.Policy.Roles

  @most 20
  @longest 60
  @most_parameters 8

  @type item :: %{label: String.t(), note: String.t(), to: String.t()}

  @doc """
  The items whose words contain all words of the query, at most #{@most}, those that begin with it first. Pages and
  commands of the vehicle that is shown come before pages of the fleet.
  """
  @spec find(Names.gateway(), Roles.source(), path :: String.t(), query :: term()) :: [item()]
  def find(gateway, user, path, query) do
    query =
      if is_binary(query),
        do: query |> String.slice(0, @longest) |> String.downcase() |> String.trim(),
        else: ""

    words = String.split(query)
    shown = shown(gateway, path)

    of_shown = if shown, do: sections(shown) ++ commands(shown, user, words), else: []

    (vehicles(gateway) ++ of_shown ++ pages(user))
    |> Enum.filter(&fits?(&1, words))
    |> Enum.sort_by(&(not String.starts_with?(String.downcase(&1.label), query)))
    |> Enum.concat(parameters(gateway, shown, query))
    |> Enum.take(@most)
  end

  defp fits?(item, words) do
    text = String.downcase("#{item.label} #{item.note}")
    Enum.all?(words, &String.contains?(text, &1))
  end

  defp shown(gateway, path) do
    with ["vehicles", id | _section] <- String.split(path, "/", trim: true),
         do: Fleet.vehicle(gateway, URI.decode(id)),
         else: (_other -> nil)
  end

  defp vehicles(gateway) do
    for %{id: id, vehicle_type: kind, status: status} <- Fleet.vehicles(gateway),
        do: %{label: id, note: "#{kind}, #{status}", to: Sections.path(id, "fly")}
  end

  defp pages(user),
    do:
      for(
        %{label: label, path: path} <- Pages.entries(user.role),
        do: %{label: label, note: "page", to: path}
      )

  defp sections(%{id: id}),
    do:
      for({name, label, _icon} <- Sections.all(), do: %{label: label, note: id, to: Sections.path(id, name)})

  # All of them would only hide what else there is.
  defp commands(_vehicle, _user, []), do: []

  defp commands(%{id: id} = vehicle, user, words) do
    for {_group, entries} <- Catalog.groups(vehicle, user, Enum.join(words, " ")),
        %{gap: nil, denied: nil, type: %{name: name}, title: title} <- entries,
        do: %{label: title, note: "command of #{id}", to: Sections.command_path(id, name)}
  end

  # By the names that were read of the vehicle. None are read for a palette: the last item leads to their page, which
  # reads them, and shows those with this in their names.
  defp parameters(_gateway, nil, _query), do: []

  defp parameters(gateway, %{id: id} = vehicle, query) do
    to = &("/params?" <> URI.encode_query(vehicle: id, search: &1))

    if query =~ ~r/\A[a-z0-9_]{3,}\z/ do
      named =
        for name <- names(gateway, vehicle),
            String.contains?(String.downcase(name), query),
            do: %{label: name, note: "parameter of #{id}", to: to.(name)}

      more = %{label: String.upcase(query), note: "parameters of #{id}", to: to.(query)}
      Enum.take(named, @most_parameters) ++ [more]
    else
      []
    end
  end

  # Kept for the vehicle that was asked for last: a list is some hundred kilobytes on the disk, and each letter asks.
  defp names(gateway, %{id: id} = vehicle) do
    case Store.recall(gateway, :palette_names) do
      {^id, names} ->
        names

      _other ->
        names = Params.names(gateway, vehicle)
        _ = if names != [], do: Store.remember(gateway, :palette_names, {id, names})
        names
    end
  end
end
