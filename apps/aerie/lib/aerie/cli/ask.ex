defmodule Aerie.CLI.Ask do
  @moduledoc "Asks for confirmation before something moves or changes a vehicle."

  @doc "`:ok` if the answer is yes or `--yes` was given. If nobody can answer, it is an error."
  @spec first(String.t(), %{optional(atom()) => term()}) :: :ok | {:error, String.t()}
  def first(what, options) do
    if options[:yes] do
      :ok
    else
      case IO.gets("#{String.trim(what)}: are you sure? [y/N] ") do
        answer when is_binary(answer) ->
          if yes?(answer), do: :ok, else: {:error, "not done: the answer was not yes"}

        _nobody ->
          {:error, "not done: there is nobody to confirm it; --yes confirms it beforehand"}
      end
    end
  end

  defp yes?(answer), do: answer |> String.trim() |> String.downcase() |> Kernel.in(["y", "yes"])
end
