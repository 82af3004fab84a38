defmodule FleetWeb.Console.System.Tree do
  @moduledoc """
  The present supervision tree of a gateway and of its HTTP server: supervisors are asked for their children. One that does not answer at
  once (it is starting a child) is shown without them.
  """

  alias Aerie.Base.Names

  @max_depth 8
  @max_nodes 4_096
  @ask_ms 500

  @typedoc """
  - `path`: the ids from the root; `name`: for people; `pid`: nil if it is not running
  - `memory` in bytes, `queue` in messages; nil if it has just ended
  - `restarts`: `t:FleetWeb.Console.System.Restarts.count/0` or nil
  """
  @type t :: %{
          path: [term()],
          name: String.t(),
          pid: pid() | nil,
          type: :worker | :supervisor,
          memory: non_neg_integer() | nil,
          queue: non_neg_integer() | nil,
          restarts: map() | nil,
          children: [t()]
        }

  @doc "The tree of a gateway; nil if it is not running."
  @spec of(Names.gateway()) :: t() | nil
  def of(gateway) do
    roots = for role <- [:gateway, :console], pid = Names.whereis(gateway, role), do: {role, pid, :supervisor}

    if roots != [] do
      {children, _left} = children(roots, [], gateway, @max_nodes)

      %{
        path: [],
        name: "gateway",
        pid: nil,
        type: :supervisor,
        memory: nil,
        queue: nil,
        restarts: nil,
        children: children
      }
    end
  end

  defp children(specs, path, gateway, left) do
    Enum.reduce(specs, {[], left}, fn
      _more, {nodes, 0} ->
        {nodes, 0}

      {id, pid, type}, {nodes, left} ->
        {node, left} = node(id, pid, type, path, gateway, left - 1)
        {[node | nodes], left}
    end)
    |> then(fn {nodes, left} -> {Enum.reverse(nodes), left} end)
  end

  defp node(id, pid, type, path, gateway, left) do
    names = if is_pid(pid), do: Names.roles(gateway, pid), else: []
    # All children of a dynamic supervisor have the same id, so their names distinguish them.
    id = if id == :undefined, do: List.first(names) || pid, else: id
    path = path ++ [id]
    info = if is_pid(pid), do: Process.info(pid, [:memory, :message_queue_len])
    {below, left} = if type == :supervisor, do: below(pid, path, gateway, left), else: {[], left}

    {%{
       path: path,
       name: name(id, names),
       pid: if(is_pid(pid), do: pid),
       type: type,
       memory: info[:memory],
       queue: info[:message_queue_len],
       restarts: nil,
       children: below
     }, left}
  end

  defp below(_pid, path, _gateway, left) when length(path) >= @max_depth, do: {[], left}

  defp below(pid, path, gateway, left) when is_pid(pid) do
    pid
    |> GenServer.call(:which_children, @ask_ms)
    |> Enum.reverse()
    |> Enum.map(fn {id, pid, type, _modules} -> {id, pid, type} end)
    |> children(path, gateway, left)
  catch
    :exit, _busy_or_gone -> {[], left}
  end

  defp below(_restarting, _path, _gateway, left), do: {[], left}

  defp name(_id, [{role, nil} | _]), do: "#{role}"
  defp name(_id, [{role, id} | _]), do: "#{role} #{text(id)}"
  defp name(id, []) when is_atom(id), do: id |> inspect() |> String.replace_prefix("Aerie.", "")
  defp name({module, _gateway}, []) when is_atom(module), do: inspect(module)
  defp name(id, []), do: text(id)

  defp text(id) when is_binary(id), do: id
  defp text({network, system}) when is_binary(network) and is_integer(system), do: "#{network}/#{system}"
  defp text(other), do: inspect(other, limit: 5, printable_limit: 60)

  @doc "All processes below the root, with their paths."
  @spec processes(t() | nil) :: [{[term()], pid()}]
  def processes(nil), do: []

  def processes(%{path: path, pid: pid, children: children}),
    do: if(pid, do: [{path, pid}], else: []) ++ Enum.flat_map(children, &processes/1)

  @doc "The tree with the restarts that `fun` gives for each path."
  @spec decorate(t(), ([term()] -> map() | nil)) :: t()
  def decorate(node, fun),
    do: %{node | restarts: fun.(node.path), children: Enum.map(node.children, &decorate(&1, fun))}
end
