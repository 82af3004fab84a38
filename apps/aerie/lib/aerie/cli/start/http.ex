defmodule Aerie.CLI.Start.HTTP do
  @moduledoc "The HTTP server as a part of a plan, with the console's pages and what can be asked of the whole gateway."

  alias Aerie.{Config, Incident, Reload}
  alias Aerie.Api.Endpoint
  alias Aerie.CLI.Subcommand.Recordings
  alias Aerie.Console

  # Flights go on while a page packs one.
  @incident_bytes 134_217_728

  @doc "The server; no part if it is switched off."
  @spec part(term(), Config.t()) :: [{:http, {module(), keyword()}}]
  def part(_gateway, %{http: %{enabled: false}}), do: []

  def part(gateway, config) do
    settings = Aerie.Api.Settings.from(config)

    given = %{
      configuration: fn -> gateway |> Reload.in_force(config) |> Config.Listing.sections() end,
      incident: fn vehicle, {from, to}, folder, note ->
        more = %{
          folder: folder,
          max_bytes: @incident_bytes,
          machine: Recordings.Incident.machine(config),
          note: note
        }

        Incident.make_here(gateway, vehicle, %Incident.Span{from: from, to: to}, more)
      end
    }

    options = [
      gateway: gateway,
      settings: settings,
      reload: &Reload.run(gateway, &1),
      pages: &Console.HTTP.Routes.serve(gateway, settings.console, given, &1)
    ]

    [{:http, {Endpoint, options}}]
  end

  @doc "The address that the configuration gives it."
  @spec url(Config.t()) :: String.t() | nil
  def url(%{http: %{enabled: false}}), do: nil
  def url(%{http: %{address: address, port: port}}), do: "http://#{address}:#{port}"
end
