defmodule Aerie.Fleet.AsyncAPITest do
  use ExUnit.Case, async: true

  alias Aerie.Fleet.AsyncAPI
  alias Aerie.Control.Operations
  alias Aerie.Fleet.Bridge.Hub.Accounts
  alias Aerie.Fleet.Shadow.Store.Buckets
  alias Aerie.Vehicle.Command

  @file_ Path.expand("../../../../../docs/asyncapi.json", __DIR__)

  setup_all do
    %{document: JSON.decode!(AsyncAPI.text())}
  end

  test "docs/asyncapi.json is what the tables say; mix aerie.asyncapi writes it" do
    assert File.read!(@file_) == AsyncAPI.text()
  end

  test "every reference leads somewhere, and everything that is described is used", %{document: document} do
    used = for [_all, path] <- Regex.scan(~r/"\$ref": ?"#\/([^"]+)"/, AsyncAPI.text()), uniq: true, do: path

    for path <- used, do: assert(get_in(document, String.split(path, "/")), path)

    parts =
      for(
        kind <- ~w(schemas messages parameters),
        name <- Map.keys(document["components"][kind]),
        do: "components/#{kind}/#{name}"
      )

    assert parts -- used == []
  end

  test "channels: each subject once, its parameters are described", %{document: document} do
    addresses = for {_id, %{"address" => address}} when address != nil <- document["channels"], do: address
    assert addresses == Enum.uniq(addresses)

    for {id, channel} <- document["channels"], address = channel["address"] do
      names = for [_all, name] <- Regex.scan(~r/\{(\w+)\}/, address), do: name
      assert Enum.sort(names) == Enum.sort(Map.keys(channel["parameters"] || %{})), id
    end

    for {id, operation} <- document["operations"],
        do: assert(operation["channel"]["$ref"] == "#/channels/#{id}")
  end

  test "has the subjects of a vehicle's account at the hub, of commands, the shadow and operations",
       %{
         document: document
       } do
    channels =
      for {_id, %{"address" => address}} when address != nil <- document["channels"],
          do: {address, matcher(document, address)}

    granted = Accounts.render("prod", ["UGATEWAY"], [{"VID-001", "UVEHICLE"}])

    subjects =
      for [_all, subject] <- Regex.scan(~r/subject: "((?:fleet\.|\$KV\.)[^"]+)"/, granted),
          uniq: true,
          do: subject

    assert length(subjects) > 50

    for subject <- subjects do
      # `cmd.*` and `cmd.*.progress.>` stand for several.
      examples = if String.contains?(subject, "*"), do: examples(subject), else: [subject]
      for example <- examples, do: assert(Enum.any?(channels, fn {_, regex} -> example =~ regex end), example)
    end

    buckets =
      for "$KV." <> rest <- Enum.map(channels, &elem(&1, 0)), uniq: true, do: hd(String.split(rest, "."))

    assert Enum.sort(buckets) == Enum.sort(Buckets.names())
  end

  defp examples("fleet.prod.VID-001." <> rest) do
    case String.split(rest, ".") do
      ["cmd", "*"] ->
        for name <- Command.Types.names(), do: "fleet.prod.VID-001.cmd.#{name}"

      ["cmd", "*" | _progress] ->
        for name <- Command.Types.names(), do: "fleet.prod.VID-001.cmd.#{name}.progress.a1"

      [area, "*"] ->
        for name <- Operations.names(area), do: "fleet.prod.VID-001.#{name}"

      [area, "*" | _progress] ->
        for name <- Operations.names(area), do: "fleet.prod.VID-001.#{name}.progress.a1"
    end
  end

  defp examples("$KV.fleet_plans.*"), do: ["$KV.fleet_plans." <> String.duplicate("0", 64)]

  # A parameter with values takes only those.
  defp matcher(document, address) do
    pattern =
      Regex.replace(~r/\\\{(\w+)\\\}/, Regex.escape(address), fn _all, name ->
        case document["components"]["parameters"][name]["enum"] do
          nil -> "[^.]+"
          values -> "(?:#{Enum.map_join(values, "|", &Regex.escape/1)})"
        end
      end)

    Regex.compile!("\\A#{pattern}\\z")
  end
end
