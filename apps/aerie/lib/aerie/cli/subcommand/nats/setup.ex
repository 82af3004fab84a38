defmodule Aerie.CLI.Subcommand.Nats.Setup do
  @moduledoc "`aerie nats-setup`: keys, certificates and accounts of a fleet (`Aerie.Fleet.Bridge.Hub.Setup`)."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Fleet.Bridge.Hub.Setup

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"FOLDER" => dir}, options: options, folder: folder}) do
    wish = %{
      environment: options[:environment],
      hosts: options[:host] || [],
      vehicles: options[:vehicle] || [],
      hubs: options[:hub] || [],
      revoked: options[:revoke] || [],
      new_keys: options[:new_key] || []
    }

    with {:ok, lines} <- Setup.write(Path.expand(dir, folder), wish), do: {0, Enum.map(lines, &(&1 <> "\n"))}
  end
end
