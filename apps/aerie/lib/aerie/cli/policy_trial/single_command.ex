defmodule Aerie.CLI.PolicyTrial.SingleCommand do
  @moduledoc """
  `aerie policy try --command`: what a policy decides about one command.

  `--vehicle` describes the vehicle as far as it is known, with the groups of `GET /api/vehicles/ID`
  (`Aerie.Control.Policy.Intent.Context.parse/3`). Rates are not checked: they depend on what was commanded before.
  """

  alias Aerie.Control.Policy
  alias Aerie.Control.Policy.Intent.Context
  alias Aerie.Fleet.Replay.PolicyTrial
  alias Aerie.Vehicle.Command

  @doc "The exit status and the decision; `as` is that of `Aerie.CLI.PolicyTrial.Principals.as/4`."
  @spec judge(
          Policy.t(),
          (PolicyTrial.sender() -> Policy.Roles.source()),
          Aerie.CLI.Subcommand.request(),
          now :: integer()
        ) :: {0 | 1, String.t()} | {:error, String.t()}
  def judge(policy, as, %{options: options, folder: folder}, now) do
    with :ok <- alone(options),
         {:ok, command} <- command(options.command, folder, now),
         {:ok, vehicle} <- json("--vehicle", options[:vehicle] || "{}", folder),
         {:ok, context} <- context(vehicle, as.({:source, command.source}), now) do
      case Policy.decide(policy, command, context) do
        :allow -> {0, "allow\n"}
        {:deny, rule, reason} -> {1, "deny #{rule}: #{reason}\n"}
      end
    else
      {:error, lines} -> {:error, lines |> List.wrap() |> Enum.join("\n")}
    end
  end

  defp alone(options) do
    case Enum.find([:recordings, :network, :ledger, :json], &options[&1]) do
      nil -> :ok
      other -> {:error, "--command is judged without recordings: leave out --#{other}"}
    end
  end

  defp command(text, folder, now) do
    with {:ok, %{} = given} <- json("--command", text, folder),
         {:ok, command} <-
           %{"id" => "check", "vehicle" => "any", "source" => "you"} |> Map.merge(given) |> Command.parse(now) do
      {:ok, command}
    else
      {:ok, _other} ->
        {:error, ~s(--command: expected an object such as {"type": "arm"})}

      {:error, [%Command.Error{} | _] = errors} ->
        {:error, Enum.map(errors, &"--command: #{Exception.message(&1)}")}

      {:error, text} ->
        {:error, text}
    end
  end

  defp context(vehicle, source, now) do
    with {:error, errors} <- Context.parse(vehicle, source, now),
         do: {:error, Enum.map(errors, &"--vehicle: #{&1}")}
  end

  # JSON, or the name of a file with it.
  defp json(option, text, folder) do
    with {:ok, text} <- text(String.trim_leading(text), folder),
         {:ok, value} <- JSON.decode(text) do
      {:ok, value}
    else
      {:error, posix} when is_atom(posix) -> {:error, "#{option}: #{text}: #{:file.format_error(posix)}"}
      {:error, _json} -> {:error, "#{option}: expected JSON, got something else"}
    end
  end

  defp text("{" <> _ = json, _folder), do: {:ok, json}
  defp text("[" <> _ = json, _folder), do: {:ok, json}
  defp text(file, folder), do: file |> Path.expand(folder) |> File.read()
end
