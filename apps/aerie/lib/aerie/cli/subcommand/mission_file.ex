defmodule Aerie.CLI.Subcommand.MissionFile do
  @moduledoc "`aerie mission load`: this program reads the file with its user's rights; the gateway sends the plan."
  @behaviour Aerie.CLI.Subcommand

  alias Aerie.Control.Missions
  alias Aerie.CLI.{Ask, Gateway, Subcommand}

  # Far more than the largest mission.
  @max_bytes 4_000_000

  @impl Aerie.CLI.Subcommand
  def run(%{arguments: %{"VEHICLE" => vehicle, "FILE" => file}, options: options, folder: folder} = request) do
    path = Path.expand(file, folder)

    with {:ok, kind} <- Subcommand.Mission.kind(request),
         {:ok, text} <- read(path),
         {:ok, plan} <- Missions.import(text, :any),
         {:ok, node, _entry} <- Gateway.connect(request),
         :ok <- Ask.first("send the #{kind} of #{path} to #{vehicle}", options) do
      Gateway.call(node, Subcommand.Mission, :upload, [vehicle, kind, plan, options[:force] == true])
    end
  end

  defp read(path) do
    with {:ok, %{size: size}} when size <= @max_bytes <- File.stat(path), {:ok, text} <- File.read(path) do
      {:ok, text}
    else
      {:ok, _stat} -> {:error, "#{path}: larger than #{@max_bytes} bytes"}
      {:error, posix} -> {:error, "#{path}: #{:file.format_error(posix)}"}
    end
  end
end
