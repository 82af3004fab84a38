defmodule Aerie.Control.Operations.Table do
  @moduledoc "The functions of a list of operations: `use Aerie.Control.Operations.Table, [Module, …]`."

  alias Aerie.Control.Operations.Operation

  defmacro __using__(modules) do
    quote do
      @doc "All of them."
      @spec all() :: [Operation.t(), ...]
      def all, do: for(module <- unquote(modules), do: %{module.operation() | module: module})

      @doc "The one of a name."
      @spec fetch(String.t()) :: {:ok, Operation.t()} | :error
      def fetch(name), do: Aerie.Control.Operations.Table.fetch(all(), name)
    end
  end

  @doc "The one of a name."
  @spec fetch([Operation.t()], String.t()) :: {:ok, Operation.t()} | :error
  def fetch(operations, name) do
    with nil <- Enum.find(operations, &(&1.name == name)), do: :error, else: (operation -> {:ok, operation})
  end
end
