#!/usr/bin/env node
'use strict';
/**
 * A CANopen master on a loopback channel, by the npm package `canopen` (node-canopen): CHANNEL JOINT COUNTS.
 *
 * It starts all nodes, reads their identity, samples every joint on SYNC, drives one joint by COUNTS, stops
 * it, and prints all replies as one JSON object. It uses the documented interface of this project only: the
 * datagrams of hardware/buses/loopback.py, the node numbers and the PDOs.
 */

const crypto = require('crypto');
const dgram = require('dgram');
const { Device, DataType } = require('canopen');

const [channel, jointText, countsText] = process.argv.slice(2);
const JOINT = Number(jointText);
const COUNTS = Number(countsText);
const [HOST, PORT, HEADER] = ['127.0.0.1', 43117, 18];
const [SUPERVISOR, OPERATOR, JOINTS] = [16, 127, [1, 2, 3, 4, 5, 6, 7]];
const PATIENCE_MS = 5000;

/** Frames as datagrams: "CANo", channel tag, flags, length, identifier (big endian), data. */
class LoopbackChannel {
    constructor(name) {
        this.tag = crypto.createHash('sha256').update(name).digest().subarray(0, 8);
        this.group = `239.255.${this.tag[0]}.${this.tag[1]}`;
        this.sender = dgram.createSocket('udp4');
        this.receiver = dgram.createSocket({ type: 'udp4', reuseAddr: true });
    }

    async start(onMessage) {
        await new Promise((done) => this.sender.bind(0, HOST, done));
        this.sender.setMulticastInterface(HOST);
        this.sender.setMulticastTTL(0);
        await new Promise((done) => this.receiver.bind(PORT, this.group, done));
        this.receiver.addMembership(this.group, HOST);
        const own = this.sender.address().port;
        this.receiver.on('message', (datagram, from) => {
            const ours = datagram.subarray(0, 4).toString() === 'CANo'
                && datagram.subarray(4, 12).equals(this.tag);
            if (ours && from.port !== own) {
                const data = datagram.subarray(HEADER);
                onMessage({ id: datagram.readUInt32BE(14), data, len: data.length });
            }
        });
    }

    send({ id, data }) {
        const head = Buffer.alloc(HEADER);
        head.write('CANo');
        this.tag.copy(head, 4);
        head.writeUInt8(data.length, 13);
        head.writeUInt32BE(id, 14);
        this.sender.send(Buffer.concat([head, data]), PORT, this.group);
    }

    stop() {
        this.sender.close();
        this.receiver.close();
    }
}

async function main() {
    const bus = new LoopbackChannel(channel);
    const master = new Device({ id: OPERATOR });
    const { eds } = master;
    eds.setSyncCobId(0x80);
    eds.setSyncGenerationEnable(true);
    eds.setHeartbeatProducerTime(50);
    for (const node of [...JOINTS, SUPERVISOR]) {
        eds.addSdoClientParameter(node, 0x600 + node, 0x580 + node);
        eds.addHeartbeatConsumer(node, 2000);
    }

    const add = (index, dataType) => eds.addEntry(index, { parameterName: `own ${index}`, dataType });
    const mapped = {};
    for (const joint of JOINTS) {
        const at = 0x2000 + 0x10 * joint;
        const objects = [
            add(at, DataType.UNSIGNED16), add(at + 1, DataType.INTEGER32), add(at + 2, DataType.INTEGER16),
        ];
        eds.addReceivePdo({ cobId: 0x180 + joint, dataObjects: objects });
        mapped[0x180 + joint] = { joint, objects };
    }
    const command = [
        add(0x3000, DataType.UNSIGNED16), add(0x3001, DataType.INTEGER32), add(0x3002, DataType.INTEGER8),
    ];
    // Transmitted when it is written, and at no other time.
    eds.addTransmitPdo({ cobId: 0x200 + JOINT, transmissionType: 0xFF, dataObjects: command });

    master.addListener('message', (message) => bus.send(message));
    // The supervisor grants control to an operator with a heartbeat; the first is one producer time after the start.
    const heartbeatSent = new Promise((resolve) => {
        master.on('message', ({ id }) => id === 0x700 + OPERATOR && resolve());
    });
    await bus.start((message) => {
        answers.delete(message.id);
        master.receive(message);
        if (answers.size === 0)
            answered();
    });

    let answers = new Set();
    let answered = () => {};
    const timeout = (what) => new Promise((_, reject) => {
        setTimeout(() => reject(new Error(`${what}: no answer`)), PATIENCE_MS).unref();
    });
    const read = (serverId, index, subIndex, dataType) => master.sdo.upload({
        serverId, index, subIndex, dataType, timeout: PATIENCE_MS,
    });
    const write = (serverId, index, data, dataType) => master.sdo.download({
        serverId, index, data, dataType, timeout: PATIENCE_MS,
    });
    const sync = async () => {
        const complete = new Promise((resolve) => { answered = resolve; });
        answers = new Set(JOINTS.map((joint) => 0x180 + joint));
        master.sync.write();
        await Promise.race([complete, timeout('SYNC')]);
        return Object.values(mapped).map(({ objects }) => objects.map((object) => object.value));
    };
    const drive = async (controlword, target) => {
        for (const [at, value] of [controlword, target, 8].entries())
            command[at].value = value;
        master.pdo.write(0x200 + JOINT);
        return (await sync())[JOINT - 1];
    };

    master.start();
    const replies = { identity: {} };
    for (const node of [...JOINTS, SUPERVISOR]) {
        replies.identity[node] = {
            deviceType: await read(node, 0x1000, 0, DataType.UNSIGNED32),
            name: await read(node, 0x1008, 0, DataType.VISIBLE_STRING),
            vendor: await read(node, 0x1018, 1, DataType.UNSIGNED32),
            product: await read(node, 0x1018, 2, DataType.UNSIGNED32),
            serial: await read(node, 0x1018, 4, DataType.UNSIGNED32),
        };
    }
    const operational = Promise.all([...JOINTS, SUPERVISOR].map((node) => new Promise((resolve) => {
        const resolveWhenOperational = ({ deviceId, state }) => {
            if (deviceId === node && state === 5)
                resolve();
        };
        master.nmt.on('heartbeat', resolveWhenOperational);
    })));
    master.nmt.startNode(0);
    await Promise.race([operational, timeout('NMT start')]);

    replies.first = await sync();
    await heartbeatSent;
    await write(SUPERVISOR, 0x2010, OPERATOR, DataType.UNSIGNED32);
    replies.token = await read(SUPERVISOR, 0x2010, 0, DataType.UNSIGNED32);

    const start = replies.first[JOINT - 1][1];
    replies.enabling = [];
    for (const controlword of [0x06, 0x07, 0x0F])
        replies.enabling.push((await drive(controlword, start))[0]);
    replies.mode = await read(JOINT, 0x6061, 0, DataType.INTEGER8);
    for (let step = 1; step <= 10; ++step)
        replies.driven = await drive(0x0F, start + Math.round(COUNTS * step / 10));
    await write(JOINT, 0x6040, 0x02, DataType.UNSIGNED16);
    replies.stopped = (await sync())[JOINT - 1];
    replies.statusword = await read(JOINT, 0x6041, 0, DataType.UNSIGNED16);
    // A stopped drive ignores its target.
    replies.afterwards = await drive(0x02, start);

    replies.refused = await read(JOINT, 0x5FFF, 0, DataType.UNSIGNED8).catch((error) => error.message);
    await write(SUPERVISOR, 0x2010, 0, DataType.UNSIGNED32);
    master.stop();
    bus.stop();
    console.log(JSON.stringify(replies));
}

main().then(() => process.exit(0), (error) => {
    console.error(error.stack);
    process.exit(1);
});
