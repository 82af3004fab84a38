defmodule Aerie.CLI.Start.HTTP do
  @moduledoc "The HTTP server as a part of a plan, with the console's pages and what can be asked of the whole gateway."

  alias Aerie.{Config, Reload}
  alias Aerie.Api.Endpoint
  alias Aerie.Console

  @doc "The server; no part if it is switched off."
  @spec part(term(), Config.t()) :: [{:http, {module(), keyword()}}]
  def part(_gateway, %{http: %{enabled: false}}), do: []

  def part(gateway, config) do
    settings = Aerie.Api.Settings.from(config)
    configuration = fn -> gateway |> Reload.in_force(config) |> Config.Listing.sections() end

    options = [
      gateway: gateway,
      settings: settings,
      reload: &Reload.run(gateway, &1),
      pages: &Console.HTTP.Routes.serve(gateway, settings.console, configuration, &1)
    ]

    [{:http, {Endpoint, options}}]
  end

  @doc "The address that the configuration gives it."
  @spec url(Config.t()) :: String.t() | nil
  def url(%{http: %{enabled: false}}), do: nil
  def url(%{http: %{address: address, port: port}}), do: "http://#{address}:#{port}"
end
