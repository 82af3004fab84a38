defmodule Aerie.Tool.Ask do
  @moduledoc "Asks a person before something that moves or changes a vehicle."

  @doc "`:ok` if the answer is yes, or `--yes` was given. Without anybody to answer it is no."
  @spec first(String.t(), %{optional(atom()) => term()}) :: :ok | {:error, String.t()}
  def first(what, options) do
    if options[:yes] do
      :ok
    else
      case IO.gets("#{String.trim(what)}: are you sure? [y/N] ") do
        answer when is_binary(answer) ->
          if yes?(answer), do: :ok, else: {:error, "not done: the answer was not yes"}

        _nobody ->
          {:error, "not done: nobody is there to confirm it; --yes says so beforehand"}
      end
    end
  end

  defp yes?(answer), do: answer |> String.trim() |> String.downcase() |> Kernel.in(["y", "yes"])
end
