defmodule Aerie.Processes.Tree do
  @moduledoc """
  The present supervision tree of a gateway and of its console: supervisors are asked for their children. One that does
  not answer at once (it is starting a child) is shown without them.
  """

  alias Aerie.Base.Names

  @max_depth 8
  @max_nodes 4_096
  @ask_ms 500

  @typedoc """
  - `path`: the ids from the root; `name`: for people; `pid`: nil if it is not running
  - `memory` in bytes, `queue` in messages; nil if it has just ended
  """
  @type tree_node :: %{
          path: [term()],
          name: String.t(),
          pid: pid() | nil,
          memory: non_neg_integer() | nil,
          queue: non_neg_integer() | nil
        }

  @doc "The processes, each after its supervisor; none of a gateway that is not running."
  @spec of(Names.gateway()) :: [tree_node()]
  def of(gateway) do
    roots = for role <- [:gateway, :console], pid = Names.whereis(gateway, role), do: {role, pid, :supervisor}
    roots |> branches([], gateway) |> Enum.take(@max_nodes)
  end

  defp branches(children, path, gateway), do: Stream.flat_map(children, &branch(&1, path, gateway))

  defp branch({id, pid, type}, above, gateway) do
    names = if is_pid(pid), do: Names.roles(gateway, pid), else: []
    # All children of a dynamic supervisor have the same id, so their names distinguish them.
    id = if id == :undefined, do: List.first(names) || pid, else: id
    path = above ++ [id]
    info = if is_pid(pid), do: Process.info(pid, [:memory, :message_queue_len])
    pid = if is_pid(pid), do: pid

    node = %{
      path: path,
      name: name(id, names),
      pid: pid,
      memory: info[:memory],
      queue: info[:message_queue_len]
    }

    Stream.concat([node], if(type == :supervisor and pid != nil, do: below(pid, path, gateway), else: []))
  end

  defp below(_pid, path, _gateway) when length(path) >= @max_depth, do: []

  defp below(pid, path, gateway) do
    pid
    |> GenServer.call(:which_children, @ask_ms)
    |> Enum.reverse()
    |> Enum.map(fn {id, pid, type, _modules} -> {id, pid, type} end)
    |> branches(path, gateway)
  catch
    :exit, _busy_or_gone -> []
  end

  defp name(_id, [{role, nil} | _]), do: "#{role}"
  defp name(_id, [{role, id} | _]), do: "#{role} #{text(id)}"
  defp name(id, []) when is_atom(id), do: id |> inspect() |> String.replace_prefix("Aerie.", "")
  defp name({module, _gateway}, []) when is_atom(module), do: inspect(module)
  defp name(id, []), do: text(id)

  defp text(id) when is_binary(id), do: id
  defp text({network, system}) when is_binary(network) and is_integer(system), do: "#{network}/#{system}"
  defp text(other), do: inspect(other, limit: 5, printable_limit: 60)
end
