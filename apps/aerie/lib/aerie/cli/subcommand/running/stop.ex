defmodule Aerie.CLI.Subcommand.Running.Stop do
  @moduledoc "`aerie stop`: shuts a gateway down, and waits until its process has ended."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.CLI.Gateway

  @impl Aerie.CLI.Subcommand
  def run(request) do
    with {:ok, node, entry} <- Gateway.connect(request) do
      :ok = :net_kernel.monitor_nodes(true, node_type: :all)
      :ok = Gateway.call(node, System, :stop, [])

      receive do
        {:nodedown, ^node, _info} -> await(entry)
      end
    end
  end

  # Distribution ends before the operating system's process does.
  defp await(entry) do
    if File.exists?("/proc/#{entry.pid}") do
      Process.sleep(50)
      await(entry)
    else
      {0, "#{entry.name} has ended\n"}
    end
  end
end
