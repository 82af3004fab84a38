defmodule MavCodec.Generated.Messages.Part1 do
  use MavCodec.Definition.Shard, messages: {1, 8}
end
